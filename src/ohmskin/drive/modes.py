"""The drive modes of the paper, under its labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from ohmskin.drive.optimal import OptimalDrive
from ohmskin.drive.policy import Policy, base_pattern
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
        base: The pattern driven first, every time; in tracking modes what is driven while nothing is touched.
        optimal: Chooses a second pattern from what the first one showed; None in fixed and tracking modes.
        fuse: Whether the image of an adaptive mode uses the base data too.
        policy: Chooses the one pattern of each cycle of a tracking mode; None in others.
    """

    name: str
    title: str
    base: DrivePattern
    optimal: AdaptiveDrive | None = None
    fuse: bool = True
    policy: Policy | None = None

    @property
    def complete(self) -> DrivePattern:
        """All that it may ever drive beside its base."""
        chooser = self.policy or self.optimal
        return chooser.complete if chooser else self.base


def modes(
    electrodes: Electrodes,
    pairs: int = 16,
    fuse: bool = True,
    informed: AdaptiveDrive | None = None,
    tracking: Policy | None = None,
) -> dict[str, Mode]:
    """The modes that an electrode layout allows, the paper's best last.

    ``12B``/``16B``: adjacent drive on the rim (12 or 16 electrodes there); ``16I``: adjacent drive on the rim and on the
    inner ring; ``16O``: the rim's base scan, then the pairs chosen by eq. (7) among all electrodes. Other layouts get the
    same three with their own numbers. With an `informed` drive there is ``16P``, too: opposite drives measured at all electrodes,
    then what the drive chooses; with a `tracking` policy ``16T``: few injections a frame, contacts followed from frame to frame.

    Args:
        electrodes: Electrode layout.
        pairs: Injections of the optimal scan (K).
        fuse: Whether the optimal image uses the base scan's data as well.
        informed: Second scan of ``16P``, such as a `PositionDrive` for `base_pattern(electrodes)`.
        tracking: Chooses the injections of ``16T``, such as an `InformedPolicy`.
    """
    rim, total = electrodes.rings[0], len(electrodes)
    base = adjacent([rim])
    found = [Mode(f"{len(rim)}B", f"adjacent, {len(rim)} electrodes on the rim", base)]
    if len(electrodes.rings) > 1:
        found.append(
            Mode(f"{total}I", f"adjacent, {len(rim)} on the rim and {total - len(rim)} inside", adjacent(electrodes.rings))
        )
    if informed is not None:
        opposite = base_pattern(electrodes)
        title = f"adaptive, {opposite.n_inj} opposite and {informed.pairs} informed injections"
        found.append(Mode(f"{total}P", title, opposite, informed))
    if tracking is not None:
        title = "tracking, a few injections a frame where they tell most"
        found.append(Mode(f"{total}T", title, tracking.next((), 0), policy=tracking))
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
