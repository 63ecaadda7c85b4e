"""Ways for a robot to touch itself: postures, found by chance, in which a skin meets another of its links."""

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.robot.simulation import RobotSimulation

_FREE_TURN = 1.0  # rad, tried of joints without limits
_STEPS = 80  # along a way
_TRIES = 3000
_RIM = 0.012  # m from the rim of a skin, within which a touch would not be on it for long


def way_to_itself(simulation: RobotSimulation, random: np.random.Generator) -> Floats:
    """Joint positions (rad, m) towards which the robot, from where it stands now, soon touches itself with a skin.

    Raises:
        ModelError: If no such posture is found.
    """
    start = simulation.data.qpos.copy()
    low, high = np.maximum(simulation.low, start - _FREE_TURN), np.minimum(simulation.high, start + _FREE_TURN)
    trial = simulation.copy()
    for _ in range(_TRIES):
        end = random.uniform(low, high)
        for share in np.linspace(0.0, 1.0, _STEPS)[1:]:
            trial.stand(start + share * (end - start))
            if (touching := trial.touching()) is None:
                continue
            patch, place = touching
            if share > 0.2 and simulation.body.patches[patch].skin.domain.depth([place])[0] > _RIM:
                return np.asarray(start + (share + 0.15) * (end - start))
            break
    raise ModelError(
        f"body {simulation.body.name!r} does not touch itself with a skin in any of {_TRIES} postures; "
        "leave out --self-touches, or widen the limits of its joints"
    )
