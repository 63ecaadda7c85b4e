"""Drives by name.

Other packages add theirs with an entry point of the group ``ohmskin.drives``: a function of `DriveSettings` and a
number of injections (0: as many as usual) that returns a `Drive`, its documentation's first line the title.
"""

from collections.abc import Callable
from dataclasses import dataclass

from ohmskin.drive.bound import best_fixed
from ohmskin.drive.design import Candidates
from ohmskin.drive.drive import Drive, Fixed, TwoScans
from ohmskin.drive.informed import InformedPolicy, PositionDrive
from ohmskin.drive.local import LocalDrive
from ohmskin.drive.optimal import OptimalDrive, part_of
from ohmskin.drive.patterns import Exploration, base_pattern
from ohmskin.errors import PatternError
from ohmskin.forward import ContactTable
from ohmskin.geometry import Electrodes
from ohmskin.registry import Registry
from ohmskin.scan import adjacent

_TRACKED = 4  # injections a frame that suffice to follow contacts


def _undesigned() -> tuple[ContactTable, Candidates]:
    raise PatternError("this drive needs to know what contacts do to the data; give the responses of contacts")


@dataclass(frozen=True)
class DriveSettings:
    """What a drive is made for.

    Args:
        electrodes: Electrode layout.
        design: Gives the responses of contacts, and all pairs of electrodes with their currents and noise, such as
            `Skin.design`; only called by drives that need it.
        pairs: Injections of a second scan, unless a drive is told otherwise (K).
    """

    electrodes: Electrodes
    design: Callable[[], tuple[ContactTable, Candidates]] = _undesigned
    pairs: int = 16


def rim(s: DriveSettings, injections: int) -> Drive:
    """Adjacent electrodes of the rim."""
    return _all_of(Fixed(adjacent([s.electrodes.rings[0]])), injections)


def rings(s: DriveSettings, injections: int) -> Drive:
    """Adjacent electrodes of the rim and of the inner ring."""
    if len(s.electrodes.rings) < 2:
        raise PatternError("drive 'rings' needs electrodes inside the sheet; this skin has them on the rim alone")
    return _all_of(Fixed(adjacent(s.electrodes.rings)), injections)


def opposite(s: DriveSettings, injections: int) -> Drive:
    """Opposite electrodes of the rim, measured at all others."""
    return _all_of(Fixed(base_pattern(s.electrodes)), injections)


def best(s: DriveSettings, injections: int) -> Drive:
    """The fixed set of injections with the least position error over the sheet."""
    table, candidates = s.design()
    return Fixed(part_of(candidates.pattern, best_fixed(table, candidates, injections or s.pairs)))


def eq7(s: DriveSettings, injections: int) -> Drive:
    """Adjacent base scan of the rim, then the pairs closest to the contacts (paper, eq. 7)."""
    base = adjacent([s.electrodes.rings[0]])
    return TwoScans(base, OptimalDrive(s.electrodes, _second(injections, base.n_inj, s.pairs)))


def local(s: DriveSettings, injections: int) -> Drive:
    """Adjacent base scan of the rim, then short pairs near the contacts (the paper's reference [14])."""
    base = adjacent([s.electrodes.rings[0]])
    return TwoScans(base, LocalDrive(s.electrodes, _second(injections, base.n_inj, s.pairs)))


def position(s: DriveSettings, injections: int) -> Drive:
    """Opposite base scan, then the pairs that are most informative about the contacts' positions."""
    base = base_pattern(s.electrodes)
    pairs = _second(injections, base.n_inj, s.pairs)
    return TwoScans(base, PositionDrive(s.electrodes, s.design, pairs, base.injections))


def tracking(s: DriveSettings, injections: int) -> Drive:
    """A few injections a frame: some explore, the others are most informative about the contacts followed."""
    return InformedPolicy(s.electrodes, s.design, injections or _TRACKED)


def rotating(s: DriveSettings, injections: int) -> Drive:
    """A few injections a frame in a fixed round of opposite electrodes."""
    return Exploration(s.electrodes, injections or _TRACKED)


def _all_of(drive: Fixed, injections: int) -> Drive:
    if injections not in (0, drive.injections):
        return drive.with_injections(injections)
    return drive


def _second(injections: int, base: int, usual: int) -> int:
    """Injections left for the second scan."""
    if injections and injections <= base:
        raise PatternError(f"{injections} injections a frame; the base scan alone has {base}, so give more")
    return injections - base if injections else usual


DRIVES: Registry[Callable[[DriveSettings, int], Drive]] = Registry(
    "drive",
    "ohmskin.drives",
    {drive.__name__: drive for drive in (rim, rings, opposite, best, eq7, local, position, tracking, rotating)},
    PatternError,
)
"""Drives by name."""
