"""Hands from outside: a fingertip that pokes, pads of arms that hug. Each comes to a skin, pushes on, and goes."""

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.robot.simulation import Push, RobotSimulation, above

_ABOVE = 0.03  # m: where a hand starts, above the skin
_APPROACH = 0.08  # m/s
_RETREAT = 0.25  # m/s, afterwards
_PUSH = 0.02  # m beyond the first touch that it wants to go
_HARDEST = 20.0  # N that it pushes with at most
_HOLD = 0.25  # s at the end of a push


class Hand:
    """One hand on its way to a place of a skin.

    Args:
        simulation: The robot.
        number: Which hand it is, of `RobotSimulation.hands`.
        patch: The skin.
        aim: The place (2,) on its map (m).

    Attributes:
        point: (3,) where the middle of its tip is to be, in the world (m).
        push: What it presses now; None if it does not touch.
        touched_at: When it first touched (s); NaN if it has not.
        where: Place (2,) of that touch on the map (m).
        peak: Largest force so far (N).
    """

    def __init__(self, simulation: RobotSimulation, number: int, patch: int, aim: Floats) -> None:
        self.number, self.patch = number, patch
        self._simulation, self._aim, self._height, self._pushed, self._held = simulation, aim, _ABOVE, 0.0, 0.0
        self._direction = np.zeros(3)
        self.push: Push | None = None
        self.touched_at, self.peak, self.where = np.nan, 0.0, (np.nan, np.nan)
        self.point = self._over()
        simulation.place_hand(self.point, simulation.surface(patch, aim)[1], number)

    @property
    def done(self) -> bool:
        """Whether it has pushed for as long as it wants to, or something holds it off."""
        return self._held >= _HOLD or self._height < -_PUSH

    def advance(self, elapsed: float) -> None:
        """Go on for a time (s): it follows the moving skin until it touches, then pushes straight on."""
        step = _APPROACH * elapsed
        if np.isnan(self.touched_at):
            self._height -= step
            self.point = self._over()
        elif self._pushed < _PUSH:
            force = self.push.force if self.push else 0.0
            self.point = self.point + self._direction * step * min(1.0, 1 - force / _HARDEST)
            self._pushed += step
        else:
            self._held += elapsed

    def update(self, pushes: tuple[Push, ...], time: float) -> None:
        """Take note of what it presses at a time (s)."""
        own = (push for push in pushes if push.patch == self.patch and push.hand == self.number)
        self.push = next(own, None)
        if self.push is not None:
            self.peak = max(self.peak, self.push.force)
            if np.isnan(self.touched_at):
                self._direction, self.touched_at = -self._simulation.surface(self.patch, self._aim)[1], time
                self.where = (float(self.push.place[0]), float(self.push.place[1]))

    def retreat(self, elapsed: float) -> None:
        """Go back for a time (s)."""
        self.point = self.point - self._direction * _RETREAT * elapsed

    def _over(self) -> Floats:
        return above(self._simulation, self.patch, self._aim, self._height, self._simulation.hands[self.number])
