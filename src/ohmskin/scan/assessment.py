"""Assessment: which electrodes can be trusted, judged from the data alone.

Nothing here knows the sheet. Four things are looked at, each for the electrodes behind the measurements: values that
are missing or clipped; signals that are absent although current should flow; disagreement with every resistive network
(`NetworkFit`), of quiet frames and of changes against them; scatter and drift of repeated quiet frames.

A suspect must not blacken its neighbours, with which it shares measurements. So electrodes are taken out one by one,
always the one whose leaving helps most; the rest is the yardstick; then each is put back alone, and judged by what its
return adds.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, combinations

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import DataError
from ohmskin.scan import consistency
from ohmskin.scan.consistency import ABSENT, FLOOR, NOISE_SHARE
from ohmskin.scan.frame import Frame
from ohmskin.scan.pattern import DrivePattern
from ohmskin.scan.quality import Quality, Verdict, in_words
from ohmskin.scan.repeats import Repeats, by_pattern, finite, known_mean, rms

_SCATTER = 5.0  # times the others' scatter or drift above which an electrode counts less
_MISSING = 0.5  # share of an electrode's values that may be missing or clipped
_REPEATS = 6  # quiet frames from which drift can be told from noise


def assess(quiet: Sequence[Frame], frames: Sequence[Frame] = ()) -> Quality:
    """Assess the electrodes of quiet frames and, if given, of frames of the touched skin.

    Args:
        quiet: Frames of the untouched skin, of one or several patterns.
        frames: Frames to look at; their changes against the quiet frames must obey reciprocity, too.

    Raises:
        DataError: If there is no quiet frame.
    """
    if not quiet:
        raise DataError("no quiet frames to judge; give at least one frame of the untouched skin")
    groups, touched = by_pattern(quiet), by_pattern(frames)
    n_elec = 1 + max(int(pattern.quadruples.max()) for pattern in [*groups, *touched])
    found: dict[int, Verdict] = {}

    def add(verdicts: Iterable[Verdict]) -> None:
        for verdict in verdicts:
            if verdict.electrode not in found or verdict.weight < found[verdict.electrode].weight:
                found[verdict.electrode] = verdict

    def bad() -> list[int]:
        return [e for e, verdict in found.items() if verdict.weight == 0]

    for group in chain(groups.values(), touched.values()):
        add(_unmeasured(group))
    for state in (groups, touched):
        add(_silent(list(state.values())))
    for group in groups.values():
        add(chain(_scatter(group), _drift(group)))
    for pattern, group in groups.items():
        for volts, changes in consistency.data_columns(group, touched[pattern].frames if pattern in touched else []):
            add(consistency.inconsistent(group, volts, changes, bad()))
    every = np.concatenate([frame.voltages for frame in [*quiet, *frames]])
    return Quality(
        n_elec,
        tuple(found[e] for e in sorted(found)),
        *consistency.noise_levels(groups.values(), bad()),
        consistency.electrode_errors(groups.values(), bad(), n_elec),
        every.size,
        int(np.isnan(every).sum()),
        int(np.isinf(every).sum()),
    )


def _inconsistent_electrodes(
    pattern: DrivePattern, squares: Floats, factor: float, floor: float
) -> tuple[dict[int, float], float]:
    """Electrodes whose rms is above `factor` times that of the rest and above `floor`, with their rms; and the rest's.

    `squares` (n_meas,) are independent of each other, such as the variances of repeated measurements.
    """
    used = [int(e) for e in np.unique(pattern.quadruples)]
    involved = {e: pattern.uses(e) for e in used}
    kept = known = np.isfinite(squares)
    out: list[int] = []
    for _ in range(max(1, len(used) // 4)):
        # the most significant: high squares, and many of them; a neighbour shares some, and has good ones besides
        scores = {e: squares[own].sum() / np.sqrt(own.sum()) for e in used if (own := kept & involved[e]).any()}
        worst = max(scores, key=lambda e: scores[e], default=None)
        if worst is None or not (rest := kept & ~involved[worst]).any():
            break
        out.append(worst)
        kept = rest
    core = float(np.sqrt(np.mean(squares[kept]))) if kept.any() else 0.0
    inconsistent = {}
    for e in reversed(out):  # the least guilty first
        own = known & involved[e] & ~pattern.uses([other for other in out if other != e])
        level = float(np.sqrt(np.mean(squares[own]))) if own.any() else 0.0
        if level > max(factor * core, floor):
            inconsistent[e] = level
        else:
            out.remove(e)
    return inconsistent, core


def _unmeasured(group: Repeats) -> Iterator[Verdict]:
    """Electrodes most of whose values are NaN or infinite."""
    volts = np.stack([frame.voltages for frame in group.frames])
    inconsistent, _ = _inconsistent_electrodes(group.pattern, (~np.isfinite(volts)).mean(axis=0) ** 2, 0.0, _MISSING)
    for e in inconsistent:
        own = volts[:, group.pattern.uses(e)]
        clipped, missing = np.isinf(own).mean(), np.isnan(own).mean()
        kind, what = ("clipped", "at the end of the converter's range") if clipped > missing else ("missing", "missing")
        words = f"{kind}: {100 * max(clipped, missing):.0f} % of its values are {what}; left out"
        yield Verdict(e, kind, 0.0, words)


def _silent(groups: Sequence[Repeats]) -> Iterator[Verdict]:
    """Electrodes that no current or no voltage reaches, and pairs that are at one potential, in all patterns together.

    In one pattern alone, such as a part of a larger one, an electrode may be far from all that is driven.
    """
    if not groups:
        return
    quadruples = np.concatenate([group.pattern.quadruples for group in groups])
    injections = np.concatenate([group.pattern.injections for group in groups])
    used = [int(e) for e in np.unique(quadruples)]
    involved = {e: (quadruples == e).any(axis=1) for e in used}
    means = [known_mean(np.stack([finite(frame.currents) for frame in group.frames])) for group in groups]
    currents = np.abs(np.concatenate(means))
    squares = np.concatenate([known_mean(group.voltages**2) for group in groups])

    def level(electrode: int, without: tuple[int, ...] = ()) -> float:
        own = involved[electrode] & ~np.isin(quadruples, without).any(axis=1)
        return float(np.sqrt(known_mean(squares[own]))) if own.any() else float("nan")

    typical = float(np.nanmedian(currents)) if np.isfinite(currents).any() else 0.0
    driven = {e: currents[(injections == e).any(axis=1)] for e in used}
    idle = [e for e, own in driven.items() if own.size and np.nanmax(own, initial=0.0) < ABSENT * typical]
    words = "open: almost no current flows when it is driven; check its wire; left out"
    yield from (Verdict(e, "open", 0.0, words) for e in idle)
    levels = {e: level(e, tuple(set(idle) - {e})) for e in used}  # open ones pick up anything
    middle = float(np.nanmedian(list(levels.values()))) if np.isfinite(list(levels.values())).any() else 0.0
    quiet = [e for e in used if levels[e] < ABSENT * middle]
    # an electrode between two silent ones is silent with them: blame as few as can explain it all
    for count in range(len(quiet) + 1) if len(quiet) <= 8 else [len(quiet)]:
        explained = [
            chosen for chosen in combinations(quiet, count)
            if not any(level(e, chosen) < ABSENT * middle for e in quiet if e not in chosen)
        ]  # fmt: skip
        if explained:
            quiet = list(explained[0])
            break
    for e in quiet:
        share = f"its voltages are {100 * levels[e] / middle:.2g} % of the others'"
        yield Verdict(e, "open", 0.0, f"open: {share}, as if nothing were connected; left out")
    if not idle and not quiet:
        yield from _shorted(quadruples, squares)


def _shorted(quadruples: Ints, squares: Floats) -> Iterator[Verdict]:
    """Pairs between which no voltage is ever measured, and that drive nothing, while each alone does its work."""
    pairs: dict[tuple[int, int], list[float]] = defaultdict(list)
    for (a, b, c, d), square in zip(quadruples.tolist(), squares.tolist(), strict=True):
        if np.isfinite(square):
            pairs[min(a, b), max(a, b)].append(square)
            pairs[min(c, d), max(c, d)].append(square)
    level = {pair: float(np.sqrt(np.mean(own))) for pair, own in pairs.items() if len(own) >= 3}
    middle = float(np.median(list(level.values()))) if level else 0.0
    for (a, b), own in level.items():
        if own < 0.02 * middle:
            for e, other in ((a, b), (b, a)):
                words = f"shorted to electrode {other}: their voltages are always equal; check for a bridge; left out"
                yield Verdict(e, "shorted", 0.0, words)


def _scatter(group: Repeats) -> Iterator[Verdict]:
    """Electrodes whose values scatter more than the others' while nothing touches the skin."""
    if len(group.frames) < 2:
        return
    floor = FLOOR * rms(group.voltages)
    inconsistent, core = _inconsistent_electrodes(group.pattern, group.scatter, _SCATTER, _SCATTER * floor)
    for e, scatter in inconsistent.items():
        excess = scatter / max(core, floor)
        words = f"its values scatter by {in_words(scatter)} at rest, {excess:.0f} times the others'"
        if scatter > NOISE_SHARE * rms(group.voltages[:, group.pattern.uses(e)]):
            words = f"open: {words}, and have no other signal; check its contact; left out"
            yield Verdict(e, "open", 0.0, words)
        else:
            yield Verdict(e, "noisy", 1 / excess, f"noisy: {words}; lower weight")


def _drift(group: Repeats) -> Iterator[Verdict]:
    """Electrodes whose values wander from the first to the last third of the quiet frames."""
    volts = group.voltages
    if len(volts) < _REPEATS:
        return
    third = len(volts) // 3
    change = known_mean(volts[-third:]) - known_mean(volts[:third])
    noise = 2 * group.scatter / third  # of such a change squared, were there only noise
    floor = FLOOR * rms(volts)
    inconsistent, core = _inconsistent_electrodes(group.pattern, change**2, _SCATTER, _SCATTER * floor)
    for e, wander in inconsistent.items():
        if wander <= _SCATTER * rms(np.sqrt(noise[group.pattern.uses(e)])):
            continue  # a noisy electrode, not a drifting one
        excess = wander / max(core, floor)
        words = f"drifting: its values wander by {in_words(wander)} at rest, {excess:.0f} times the others'"
        yield Verdict(e, "drifting", 1 / excess, words + "; lower weight")
