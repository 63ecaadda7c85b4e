"""A guided series of presses, one instruction at a time. The caller waits and asks the user."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.calibrate.force import PressSample
from ohmskin.contacts import Contact
from ohmskin.errors import SkinError
from ohmskin.geometry.periodic import shortest
from ohmskin.scan import Difference
from ohmskin.skin import Skin

GRAVITY = 9.80665
"""Standard acceleration of gravity (m/s2)."""
_PLASTIC = (
    1.32471795724  # x^3 = x + 1: multiples of its powers fill a square evenly, as those of the golden ratio a line
)
_FREE = 0.25  # of the usual distance between electrodes, that places keep from them: there a contact is felt otherwise
_CHOICE = 6  # places looked at for each that is pressed
_REACH = 0.03  # m from where it was asked for within which a contact is taken for the press


@dataclass(frozen=True)
class PressStep:
    """One press to be made.

    Args:
        at: Where (m).
        force: With which force (N).
        loading: Whether the force is larger than the previous one at this place.
    """

    at: tuple[float, float]
    force: float
    loading: bool

    def __str__(self) -> str:
        x, y = self.at
        change = "put" if self.loading else "leave"
        grams = f"{1e3 * self.force / GRAVITY:.0f} g"
        return f"{change} {grams} in total ({self.force:.2f} N) at x {1e3 * x:.0f} mm, y {1e3 * y:.0f} mm"


def press_plan(skin: Skin, forces: Sequence[float], places: int = 5) -> tuple[PressStep, ...]:
    """At each of some places spread over the sheet, away from electrodes, the forces upwards and downwards again.

    Args:
        skin: The skin to press.
        forces: Forces (N), two or more.
        places: Number of places.

    Raises:
        SkinError: If there are fewer than two forces or no place, or a force is not positive.
    """
    levels = sorted(set(forces))
    if len(levels) < 2 or not (levels[0] > 0 and np.isfinite(levels).all()):
        raise SkinError(f"forces are {list(forces)} N; give two or more different ones, all above 0")
    if not 1 <= places <= 100:
        raise SkinError(f"{places} places; it must be 1 to 100")
    x0, y0, x1, y1 = skin.domain.bounds
    candidates = np.mod(0.5 + np.outer(np.arange(50 * places), [1 / _PLASTIC, 1 / _PLASTIC**2]), 1.0)
    margin = 0.12 * min(x1 - x0, y1 - y0)
    points = np.array([x0, y0]) + candidates * np.array([x1 - x0, y1 - y0])
    away = np.linalg.norm(shortest(points[:, None] - skin.electrodes.positions, skin.domain.period), axis=2).min(axis=1)
    free = away > _FREE * np.sqrt(skin.domain.area / len(skin.electrodes))
    inside = points[free & (skin.domain.depth(points) > margin)][: _CHOICE * places]
    gaps, chosen = np.full(len(inside), np.inf), list[tuple[float, float]]()
    while len(chosen) < min(places, len(inside)):  # the first, then each as far as can be from all before
        x, y = inside[int(gaps.argmax())].tolist()
        gaps = np.minimum(gaps, np.linalg.norm(shortest(inside - [x, y], skin.domain.period), axis=1))
        chosen.append((x, y))
    up = [(force, True) for force in levels]
    down = [(force, False) for force in levels[-2::-1]]
    return tuple(PressStep(at, force, loading) for at in chosen for force, loading in up + down)


class PressGuide:
    """Guides through a plan: make the press `step`, call `begin`, then `add` each cycle until the step changes.

    Args:
        plan: The presses to make.
        settle: Cycles after `begin` that are not used, while foam and tracker settle.
        cycles: Number of cycles over which the median of the strength is taken.

    Attributes:
        samples: What was seen so far.
    """

    def __init__(self, plan: Sequence[PressStep], settle: int = 6, cycles: int = 10) -> None:
        self.plan, self.samples = tuple(plan), list[PressSample]()
        self._settle, self._cycles = settle, cycles
        self._seen: list[tuple[Contact | None, tuple[Difference, ...], float]] | None = None

    @property
    def step(self) -> PressStep | None:
        """The press to make now; None when all are done."""
        return self.plan[len(self.samples)] if len(self.samples) < len(self.plan) else None

    @property
    def peaks(self) -> list[float]:
        """Of each sample the greatest force before it eased off (N); 0 where it was rising."""
        peaks, greatest = [], 0.0
        for sample in self.samples:
            greatest = sample.force if sample.loading else greatest
            peaks.append(0.0 if sample.loading else greatest)
        return peaks

    def begin(self) -> None:
        """Begin to measure the press that is now made."""
        self._seen = []

    def add(self, contacts: Sequence[Contact], scans: Sequence[Difference] = (), auxiliary: float = np.nan) -> bool:
        """Add one cycle.

        Args:
            contacts: All of the cycle; the strongest one near the place of the step is used.
            scans: What was measured, (n_scans,) changes against the quiet skin.
            auxiliary: What the auxiliary channel read (N or Pa); NaN: there is none.

        Returns:
            Whether the press is done and the next step is due.
        """
        step = self.step
        if step is None or self._seen is None:
            return False
        near = [contact for contact in contacts if np.hypot(*np.subtract(contact.position, step.at)) < _REACH]
        nearest = max(near, key=lambda contact: abs(contact.strength), default=None)
        self._seen.append((nearest, tuple(scans), auxiliary))
        if len(self._seen) < self._settle + self._cycles:
            return False
        counted = self._seen[self._settle :]
        strength = float(np.median([abs(contact.strength) if contact else 0.0 for contact, _, _ in counted]))
        contact = next((contact for contact, _, _ in reversed(counted) if contact), None) if strength else None
        measured = tuple(scan for _, scans, _ in counted for scan in scans)
        auxiliary_median = float(np.median([reading for _, _, reading in counted]))
        self.samples.append(
            PressSample(step.at, step.force, strength, step.loading, contact, measured, auxiliary_median)
        )
        self._seen = None
        return True
