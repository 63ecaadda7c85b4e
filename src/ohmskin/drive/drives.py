"""Drives by name.

Other packages add theirs with an entry point of the group ``ohmskin.drives``: a function of `DriveSettings` and a
number of injections (0: as many as usual) that returns a `Drive`, its documentation's first line the title.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ohmskin.drive.bound import best_fixed
from ohmskin.drive.design import Candidates
from ohmskin.drive.drive import Drive, Exploration, Fixed, SecondScan, TwoScans
from ohmskin.drive.optimal import LocalDrive, OptimalDrive
from ohmskin.drive.patterns import base_pattern, is_local, part_of
from ohmskin.drive.position import PositionDrive, TrackingDrive
from ohmskin.errors import PatternError
from ohmskin.forward import ContactTable
from ohmskin.geometry import Electrodes
from ohmskin.registry import Registry
from ohmskin.scan import DrivePattern, adjacent

_TRACKED = 4  # injections a frame that suffice to follow contacts
_SHARE = 16  # electrodes for one of them, where these are many


def _undesigned() -> tuple[ContactTable, Candidates]:
    raise PatternError("this drive needs the responses of contacts; give a contact table and candidates")


@dataclass(frozen=True)
class DriveSettings:
    """Arguments of a drive.

    Args:
        electrodes: Electrode layout.
        design: Returns the responses of contacts, and the candidates with their currents and noise, such as
            `Skin.design`; only called by drives that need it.
        pairs: Injections of a second scan, unless a drive gets another number (K).
        period: Of a closed band, 0 of others (m).
    """

    electrodes: Electrodes
    design: Callable[[], tuple[ContactTable, Candidates]] = _undesigned
    pairs: int = 16
    period: float = 0.0


def rim(s: DriveSettings, injections: int) -> Drive:
    """Adjacent electrodes of the rim."""
    return _fixed(adjacent([s.electrodes.rings[0]]), injections)


def rings(s: DriveSettings, injections: int) -> Drive:
    """Adjacent electrodes of the rim and of the inner ring."""
    if len(s.electrodes.rings) < 2:
        raise PatternError("drive 'rings' needs electrodes inside the sheet; this skin has them on the rim only")
    return _fixed(adjacent(s.electrodes.rings), injections)


def opposite(s: DriveSettings, injections: int) -> Drive:
    """Opposite electrodes of the rim, measured at all others."""
    return _fixed(base_pattern(s.electrodes, s.period), injections)


def best(s: DriveSettings, injections: int) -> Drive:
    """The fixed set of injections with the least position error over the sheet."""
    table, candidates = s.design()
    return Fixed(part_of(candidates.pattern, best_fixed(table, candidates, injections or s.pairs)))


def eq7(s: DriveSettings, injections: int) -> Drive:
    """Adjacent base scan of the rim, then the pairs closest to the contacts (paper, eq. 7)."""
    return _two_scans(s, injections, _rim(s), OptimalDrive)


def local(s: DriveSettings, injections: int) -> Drive:
    """Adjacent base scan of the rim, then short pairs near the contacts (the paper's reference [14])."""
    return _two_scans(s, injections, _rim(s), LocalDrive)


def position(s: DriveSettings, injections: int) -> Drive:
    """Opposite base scan, then the pairs that are most informative about the contacts' positions."""
    base = base_pattern(s.electrodes, s.period)
    make = partial(PositionDrive, design=s.design, base=base.injections)
    return _two_scans(s, injections, base, make)


def tracking(s: DriveSettings, injections: int) -> Drive:
    """A few injections a frame: some explore, the others are most informative about the tracked contacts."""
    count = injections or _tracked(s)
    return TrackingDrive(s.electrodes, s.design, count, explore=max(2, count // 2), period=s.period)


def rotating(s: DriveSettings, injections: int) -> Drive:
    """A few injections a frame in a fixed round of opposite electrodes."""
    return Exploration(s.electrodes, injections or _tracked(s), period=s.period)


def rotating_best(s: DriveSettings, injections: int) -> Drive:
    """A few injections a frame in a fixed round of the best fixed set, of as many injections as a second scan has."""
    table, candidates = s.design()
    chosen = candidates.pattern.injections[best_fixed(table, candidates, s.pairs)]
    return Exploration(s.electrodes, injections or _tracked(s), chosen, s.period)


def _tracked(s: DriveSettings) -> int:
    """How many injections a frame of tracking has: more where it takes more to look everywhere."""
    return max(_TRACKED, len(s.electrodes) // _SHARE) if is_local(s.electrodes) else _TRACKED


def _rim(s: DriveSettings) -> DrivePattern:
    """The paper's base scan; where electrodes are many, one of the whole skin, as the rim is far from its middle."""
    return base_pattern(s.electrodes, s.period) if is_local(s.electrodes) else adjacent([s.electrodes.rings[0]])


def _fixed(pattern: DrivePattern, injections: int) -> Drive:
    drive = Fixed(pattern)
    return drive if injections in (0, drive.injections) else drive.with_injections(injections)


def _two_scans(s: DriveSettings, injections: int, base: DrivePattern, second: Callable[..., SecondScan]) -> Drive:
    if injections and injections <= base.n_inj:
        raise PatternError(f"{injections} injections a frame; the base scan alone has {base.n_inj}, so give more")
    pairs = injections - base.n_inj if injections else s.pairs
    return TwoScans(base, second(s.electrodes, pairs=pairs, period=s.period))


DRIVES: Registry[Callable[[DriveSettings, int], Drive]] = Registry(
    "drive",
    "ohmskin.drives",
    {
        drive.__name__: drive
        for drive in (rim, rings, opposite, best, eq7, local, position, tracking, rotating, rotating_best)
    },
    PatternError,
    Drive,
)
"""Drives by name."""
