"""A virtual skin for learning: many scans of many presses at once, on one core."""

from collections.abc import Iterable, Sequence

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Fault, Press, Skin, VirtualSkin
from ohmskin.skin.twin import _against_last

_CONTACTS = 4  # between sheet and patch along each side, as in data sets: presses do to 5 % what they do with more


class QuickSkin(VirtualSkin):
    """A `VirtualSkin` whose presses are modelled many at a time, by the same equations.

    Args:
        skin: What it is.
        seed: Seed of the noise.
        faults: What is wrong with its wiring.

    Raises:
        SkinError: If a fault names an electrode that is not there, or two faults name the same one.
    """

    def __init__(self, skin: Skin, seed: int | None = None, faults: Sequence[Fault] = ()) -> None:
        super().__init__(skin, seed, faults, _CONTACTS)
        self.resistances([[]])

    def scans(self, scenes: Sequence[Iterable[Press]], pattern: DrivePattern) -> list[Frame]:
        """A scan of each of n scenes, one after the other.

        Args:
            scenes: What presses in each; of a press off the sheet only what is on it counts.
            pattern: What is driven.
        """
        frames = []
        for resistance in self.resistances(scenes):
            self._resistance, self._lifted = self.wiring.seen_from_terminals(resistance), False
            frames.append(self.scan(pattern))
        return frames

    def resistances(self, scenes: Sequence[Iterable[Press]]) -> Floats:
        """(n, n_elec, n_elec) transfer resistances in ohms of n scenes, as `PressedSheet.transfer_resistance`."""
        return np.array([*map(_against_last, self.sheet._patches.many([*map(self._closed, scenes)]))])

    def _closed(self, presses: Iterable[Press]) -> tuple[Ints, Floats]:
        """Contacts (m,) of patches that presses close, and the conductance (m,) of each (S)."""
        sheet, spread = self.sheet, self.skin.contact_layer.foam_spread
        parts = [(press, np.array(sheet._near(press.position, press.radius + spread), int)) for press in presses]
        points = np.unique(np.concatenate([np.empty(0, int), *(near for _, near in parts)]))
        pressure = np.zeros((len(points), sheet._places.shape[1]))
        for press, near in parts:
            distance = sheet.distances(sheet._places[near], press)
            pressure[np.searchsorted(points, near)] += press.pressure_at(distance, spread)
        touching = pressure.any(axis=1)
        points, pressure = points[touching], pressure[touching]
        return points, sheet._conductance(pressure).mean(axis=1) * sheet._areas[points]
