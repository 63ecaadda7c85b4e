"""The drive modes of the paper, under its labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from ohmskin.drive.optimal import OptimalDrive
from ohmskin.errors import PatternError
from ohmskin.geometry import Electrodes
from ohmskin.scan import DrivePattern, adjacent


class AdaptiveDrive(Protocol):
    """Chooses a drive pattern for the contacts at hand, always `pairs` injections out of `complete`."""

    complete: DrivePattern
    pairs: int

    def pattern(self, regions: Sequence[ArrayLike]) -> DrivePattern:
        """The pattern for one or several regions, each given by its anchors (3, 2) in metres."""
        ...


@dataclass(frozen=True)
class Mode:
    """What a cycle of the loop drives.

    Args:
        name: The paper's label, such as ``16O``.
        title: What it does, in a few words.
        base: The pattern driven first, every time.
        optimal: Chooses a second pattern from what the first one showed; None in fixed modes.
        fuse: Whether the image of an adaptive mode uses the base data too.
    """

    name: str
    title: str
    base: DrivePattern
    optimal: AdaptiveDrive | None = None
    fuse: bool = True


def modes(electrodes: Electrodes, pairs: int = 16, fuse: bool = True) -> dict[str, Mode]:
    """The modes that an electrode layout allows, best last.

    ``12B``/``16B``: adjacent drive on the rim (12 or 16 electrodes there); ``16I``: adjacent drive on the rim and on the
    inner ring; ``16O``: the rim's base scan, then the pairs chosen by eq. (7) among all electrodes. Other layouts get the
    same three with their own numbers.

    Args:
        electrodes: Electrode layout.
        pairs: Injections of the optimal scan (K).
        fuse: Whether the optimal image uses the base scan's data as well.
    """
    rim, total = electrodes.rings[0], len(electrodes)
    base = adjacent([rim])
    found = [Mode(f"{len(rim)}B", f"adjacent, {len(rim)} electrodes on the rim", base)]
    if len(electrodes.rings) > 1:
        found.append(
            Mode(f"{total}I", f"adjacent, {len(rim)} on the rim and {total - len(rim)} inside", adjacent(electrodes.rings))
        )
    found.append(
        Mode(
            f"{total}O", f"adaptive, {base.n_inj} base and {pairs} optimal injections", base, OptimalDrive(electrodes, pairs), fuse
        )
    )
    return {mode.name: mode for mode in found}


def mode(name: str, electrodes: Electrodes, pairs: int = 16, fuse: bool = True) -> Mode:
    """The mode of the given name.

    Raises:
        PatternError: If the layout does not allow it; the message lists those it does.
    """
    choices = modes(electrodes, pairs, fuse)
    if name not in choices:
        raise PatternError(f"mode {name!r} is not possible with this electrode layout; choose from {', '.join(choices)}")
    return choices[name]
