"""A virtual skin for learning: many scans of many presses at once, on one core."""

from collections.abc import Iterable, Sequence

from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Fault, Press, Skin, VirtualSkin

_CONTACTS = 4  # between sheet and patch along each side, as in data sets: presses do to 5 % what they do with more


class BatchSkin(VirtualSkin):
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
        self.sheet.many([[]])  # compiles

    def scans(self, cases: Sequence[Iterable[Press]], pattern: DrivePattern) -> list[Frame]:
        """A scan of each of n cases, one after the other.

        Args:
            cases: What presses in each; of a press off the sheet only what is on it counts.
            pattern: What is driven.
        """
        frames = []
        for resistance in self.sheet.many(cases):
            self._resistance, self._stale = self.wiring.seen_from_terminals(resistance), False
            frames.append(self.scan(pattern))
        return frames
