"""Figures of the demonstration."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from ohmskin.arrays import Floats, as_plain


@dataclass(frozen=True)
class Encounter:
    """One poke and its result.

    Args:
        patch: The skin that was poked.
        link: The link that it is on.
        position: Place of the first touch, on its map (m).
        felt_on: Link of the first reported contact; empty if there was none.
        reaction: Time from the first touch to the first command that yields (s); NaN if it was not detected.
        peak_force: Largest force (N).
        errors: Distance between the sensed and the true place, frame by frame (m).
        forces: True and estimated force (N), frame by frame where it was estimated.
        invented: False contacts, reported where nothing touched.
        self_touches: Frames in which the poke was reported as a self-touch.
    """

    patch: str
    link: str
    position: tuple[float, float]
    felt_on: str
    reaction: float
    peak_force: float
    errors: tuple[float, ...] = field(repr=False)
    forces: tuple[tuple[float, float], ...] = field(default=(), repr=False)
    invented: int = 0
    self_touches: int = 0


@dataclass(frozen=True)
class Hug:
    """One hug and its result.

    Args:
        patches: The skins that were pressed, by MuJoCo.
        felt: Those whose contacts were reported.
        reaction: Time from the first touch to the first command that yields (s); NaN if nothing was detected.
        peak_forces: Largest force on each of `patches` (N).
        errors: Distance between the sensed and the true places, contact by contact and frame by frame (m).
        forces: True and estimated force (N), likewise where it was estimated.
        totals: Sums of the true and of the estimated forces on all skins (N), of frames in which all were estimated.
        invented: False contacts, reported where nothing was.
    """

    patches: tuple[str, ...]
    felt: tuple[str, ...]
    reaction: float
    peak_forces: tuple[float, ...]
    errors: tuple[float, ...] = field(repr=False)
    forces: tuple[tuple[float, float], ...] = field(repr=False)
    totals: tuple[tuple[float, float], ...] = field(repr=False)
    invented: int = 0


@dataclass(frozen=True)
class SelfTouchTrial:
    """One self-touch of the robot and its result.

    Args:
        patches: The skins that took part.
        peak_force: Largest force (N).
        frames: Reported contacts of it, in all frames.
        told: Those of them that were reported as self-touch.
    """

    patches: tuple[str, ...]
    peak_force: float
    frames: int
    told: int


def summary(
    encounters: Sequence[Encounter], touches: Sequence[SelfTouchTrial] = (), hugs: Sequence[Hug] = ()
) -> dict[str, object]:
    """Figures of a run, for JSON: how many pokes were detected, position errors (m), reaction times (s), forces (N).

    Missing values, such as the reaction to a poke that was not detected, are None.

    Args:
        encounters: The pokes.
        touches: Touches of the robot by itself.
        hugs: Presses on several skins at once.
    """
    errors = np.concatenate([np.zeros(0), *(e.errors for e in encounters)])
    reactions = np.array([e.reaction for e in encounters])
    felt = np.isfinite(reactions)
    return {
        "pokes": len(encounters),
        "felt": int(felt.sum()),
        "on_the_right_link": sum(e.felt_on == e.link for e in encounters),
        "invented": sum(e.invented for e in encounters),
        "taken_for_self_touch": sum(e.self_touches for e in encounters),
        "frames_in_contact": len(errors),
        "position_error": _spread(errors),
        "force_error": _off([e.forces for e in encounters]),
        "reaction_time": _spread(reactions[felt]),
        "peak_force": _spread(np.array([e.peak_force for e in encounters])),
        "self_touches": len(touches),
        "self_touches_felt": sum(touch.frames > 0 for touch in touches),
        "self_touches_recognised": sum(touch.told > touch.frames / 2 for touch in touches),
        "self_touch_frames": sum(touch.frames for touch in touches),
        "self_touch_frames_recognised": sum(touch.told for touch in touches),
        "hugs": len(hugs),
        "hugged_skins": sum(len(hug.patches) for hug in hugs),
        "hugged_skins_felt": sum(len(set(hug.patches) & set(hug.felt)) for hug in hugs),
        "hugged_invented": sum(hug.invented for hug in hugs),
        "hug_position_error": _spread(np.concatenate([np.zeros(0), *(hug.errors for hug in hugs)])),
        "hug_force_error": _off([hug.forces for hug in hugs]),
        "hug_total_force_error": _off([hug.totals for hug in hugs]),
        "hug_reaction_time": _spread(np.array([hug.reaction for hug in hugs if np.isfinite(hug.reaction)])),
        "hug_peak_force": _spread(np.array([force for hug in hugs for force in hug.peak_forces])),
        "hug_list": [as_plain(asdict(hug)) for hug in hugs],
        "encounters": [as_plain(asdict(encounter)) for encounter in encounters],
    }


def _off(forces: Sequence[Sequence[tuple[float, float]]]) -> dict[str, float] | None:
    """Relative error of estimated forces."""
    true, told = np.concatenate([np.zeros((0, 2)), *(np.reshape(one, (-1, 2)) for one in forces)]).T
    return _spread(np.abs(told / true - 1))


def _spread(values: Floats) -> dict[str, float] | None:
    if not len(values):
        return None
    return {name: float(np.quantile(values, q)) for name, q in (("median", 0.5), ("p95", 0.95), ("worst", 1.0))}
