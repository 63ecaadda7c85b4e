"""Assessment: which electrodes can be trusted, told from the data alone.

Nothing here knows the sheet. Four things are looked at, each for the electrodes behind the measurements: values that are missing
or clipped; signals that are absent although current should flow; disagreement with every resistive network (`NetworkFit`), of
the quiet frames themselves and of the changes against them; scatter and drift of repeated quiet frames.

A suspect must not blacken its neighbours, with which it shares measurements. So electrodes are taken out one by one, always the
one whose leaving helps most; the rest is the yardstick; then each is put back alone, and judged by what its return adds.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from ohmskin.errors import DataError
from ohmskin.scan.frame import Floats, Frame
from ohmskin.scan.network import NetworkFit
from ohmskin.scan.pattern import DrivePattern
from ohmskin.scan.quality import Quality, Verdict, volts_in_words

_DEAD = 0.08  # share of the typical signal below which nothing arrives
_NOISE_SHARE = 0.3  # share of an electrode's own signal that contradicts the network, above which it is of no use
_SUSPECT = 2.5  # times the other electrodes' error up to which an electrode is in order
_UNEVEN = 6.0  # times the others' error above which an electrode counts less; intact tanks stay below
_SCATTER = 5.0  # times the others' scatter or drift above which an electrode counts less
_MISSING = 0.5  # share of an electrode's values that may be missing or clipped
_REPEATS = 6  # quiet frames from which drift can be told from noise
_FLOOR = 1e-4  # error below which electrodes are not compared, as a share of the signal
_EVEN = 1.3  # unevenness of residuals, rms over median, up to which they are taken for plain noise
_MOST_COLUMNS = 24


def assess(quiet: Sequence[Frame], frames: Sequence[Frame] = ()) -> Quality:
    """Judge the electrodes behind quiet frames and, if given, behind frames of the touched skin.

    Args:
        quiet: Frames of the untouched skin, of one or several patterns.
        frames: Frames to look at; their changes against the quiet frames must obey reciprocity, too.

    Raises:
        DataError: If there is no quiet frame.
    """
    if not quiet:
        raise DataError("no quiet frames to judge; give at least one frame of the untouched skin")
    groups = _by_pattern(quiet)
    touched = _by_pattern(frames)
    n_elec = 1 + max(int(pattern.quadruples.max()) for pattern in [*groups, *touched])
    found: dict[int, Verdict] = {}

    def add(verdicts: Iterable[Verdict]) -> None:
        for verdict in verdicts:
            if verdict.electrode not in found or verdict.weight < found[verdict.electrode].weight:
                found[verdict.electrode] = verdict

    for group in [*groups.values(), *touched.values()]:
        add(_unmeasured(group))
        add(_silent(group))
    for group in groups.values():
        add(_scatter(group))
        add(_drift(group))
    for pattern, group in groups.items():
        for volts, changes in _columns(group, touched.get(pattern, [])):
            bad = [e for e, verdict in found.items() if verdict.weight == 0]
            add(_inconsistent(pattern, group, volts, changes, bad))
    every = [frame.voltages for frame in [*quiet, *frames]]
    return Quality(
        n_elec,
        tuple(found[e] for e in sorted(found)),
        *_levels(groups, [e for e, v in found.items() if v.weight == 0]),
        _electrode_errors(groups, [e for e, v in found.items() if v.weight == 0], n_elec),
        sum(v.size for v in every),
        sum(int(np.isnan(v).sum()) for v in every),
        sum(int(np.isinf(v).sum()) for v in every),
    )


def _by_pattern(frames: Iterable[Frame]) -> dict[DrivePattern, list[Frame]]:
    groups: dict[DrivePattern, list[Frame]] = defaultdict(list)
    for frame in frames:
        groups[frame.pattern].append(frame)
    return groups


def _currents(frame: Frame) -> Floats:
    return frame.currents[frame.pattern.measurements[:, 0]]


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, np.nan)


def _mean(values: Floats) -> Floats:
    """Mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        mean: Floats = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return mean


def _rms(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _involves(pattern: DrivePattern, electrode: int) -> np.ndarray:
    uses: np.ndarray = (pattern.quadruples == electrode).any(axis=1)
    return uses


def _blame(pattern: DrivePattern, squares: Floats, factor: float, floor: float) -> tuple[dict[int, float], float]:
    """Electrodes whose rms is above `factor` times that of the rest and above `floor`, with their rms; and the rest's rms.

    `squares` (n_meas,) are independent of each other, such as the variances of repeated measurements.
    """
    used = [int(e) for e in np.unique(pattern.quadruples)]
    involved = {e: _involves(pattern, e) for e in used}
    kept = np.isfinite(squares)
    out: list[int] = []
    for _ in range(max(1, len(used) // 4)):
        # the most significant: high squares, and many of them; a neighbour shares some, and has good ones besides
        scores = {e: squares[own].sum() / np.sqrt(own.sum()) for e in used if (own := kept & involved[e]).any()}
        if not scores or not (rest := kept & ~involved[max(scores, key=lambda e: scores[e])]).any():
            break
        out.append(max(scores, key=lambda e: scores[e]))
        kept = rest
    core = float(np.sqrt(np.mean(squares[kept]))) if kept.any() else 0.0
    guilty = {}
    for e in reversed(out):  # the least guilty first
        others = np.isin(pattern.quadruples, [other for other in out if other != e]).any(axis=1)
        own = np.isfinite(squares) & involved[e] & ~others
        rms = float(np.sqrt(np.mean(squares[own]))) if own.any() else 0.0
        if rms > max(factor * core, floor):
            guilty[e] = rms
        else:
            out.remove(e)
    return guilty, core


def _unmeasured(group: list[Frame]) -> list[Verdict]:
    """Electrodes most of whose values are NaN or infinite."""
    pattern = group[0].pattern
    volts = np.stack([frame.voltages for frame in group])
    lost = (~np.isfinite(volts)).mean(axis=0)
    guilty, _ = _blame(pattern, lost**2, 0.0, _MISSING)
    verdicts = []
    for e in guilty:
        own = volts[:, _involves(pattern, e)]
        clipped, missing = np.isinf(own).mean(), np.isnan(own).mean()
        kind, what = ("clipped", "at the end of the converter's range") if clipped > missing else ("missing", "missing")
        verdicts.append(Verdict(e, kind, 0.0, f"{kind}: {100 * max(clipped, missing):.0f} % of its values are {what}; left out"))
    return verdicts


def _silent(group: list[Frame]) -> list[Verdict]:
    """Electrodes that no current or no voltage reaches, and pairs that are at one potential."""
    pattern = group[0].pattern
    used = [int(e) for e in np.unique(pattern.quadruples)]
    involved = {e: _involves(pattern, e) for e in used}
    currents = np.abs(_mean(np.stack([_finite(frame.currents) for frame in group])))
    squares = _mean(np.stack([_finite(frame.voltages) ** 2 for frame in group]))

    def level(electrode: int, without: tuple[int, ...] = ()) -> float:
        own = involved[electrode] & ~np.isin(pattern.quadruples, without).any(axis=1)
        return float(np.sqrt(_mean(squares[own]))) if own.any() else float("nan")

    verdicts = []
    typical = float(np.nanmedian(currents)) if np.isfinite(currents).any() else 0.0
    for e in used:
        own = currents[(pattern.injections == e).any(axis=1)]
        if own.size and np.nanmax(own, initial=0.0) < _DEAD * typical:
            verdicts.append(Verdict(e, "open", 0.0, "open: hardly any current flows when it is driven; check its wire; left out"))
    levels = {e: level(e) for e in used}
    middle = float(np.nanmedian(list(levels.values()))) if np.isfinite(list(levels.values())).any() else 0.0
    quiet = [e for e in used if levels[e] < _DEAD * middle]
    # an electrode between two silent ones is silent with them: blame as few as can explain it all
    for count in range(len(quiet) + 1) if len(quiet) <= 8 else [len(quiet)]:
        explained = [
            chosen for chosen in combinations(quiet, count)
            if not any(level(e, chosen) < _DEAD * middle for e in quiet if e not in chosen)
        ]  # fmt: skip
        if explained:
            quiet = list(explained[0])
            break
    for e in quiet:
        words = f"open: its voltages are {100 * levels[e] / middle:.2g} % of the others', as if nothing were connected; left out"
        verdicts.append(Verdict(e, "open", 0.0, words))
    return verdicts or _shorted(pattern, squares)


def _shorted(pattern: DrivePattern, squares: Floats) -> list[Verdict]:
    """Pairs between which no voltage is ever measured, and that drive nothing, while each alone does its work."""
    pairs: dict[tuple[int, int], list[float]] = defaultdict(list)
    for (a, b, c, d), square in zip(pattern.quadruples.tolist(), squares.tolist(), strict=True):
        if np.isfinite(square):
            pairs[min(a, b), max(a, b)].append(square)
            pairs[min(c, d), max(c, d)].append(square)
    level = {pair: float(np.sqrt(np.mean(own))) for pair, own in pairs.items() if len(own) >= 3}
    middle = float(np.median(list(level.values()))) if level else 0.0
    verdicts = []
    for (a, b), own in level.items():
        if own < 0.02 * middle:
            for e, other in ((a, b), (b, a)):
                words = f"shorted to electrode {other}: their voltages are always equal; check for a bridge; left out"
                verdicts.append(Verdict(e, "shorted", 0.0, words))
    return verdicts


def _scatter(group: list[Frame]) -> list[Verdict]:
    """Electrodes whose values scatter more than the others' while nothing touches the skin."""
    if len(group) < 2:
        return []
    volts = _finite(np.stack([frame.voltages for frame in group]))
    # differences of successive frames: a slow drift is no noise
    squares = _mean(np.diff(volts, axis=0) ** 2) / 2
    floor = _FLOOR * _rms(volts)
    guilty, core = _blame(group[0].pattern, squares, _SCATTER, _SCATTER * floor)
    verdicts = []
    for e, scatter in guilty.items():
        excess = scatter / max(core, floor)
        useless = scatter > _NOISE_SHARE * _rms(volts[:, _involves(group[0].pattern, e)])
        words = f"its values scatter by {volts_in_words(scatter)} at rest, {excess:.0f} times the others'"
        if useless:
            verdicts.append(Verdict(e, "open", 0.0, f"open: {words}, and carry nothing else; check its contact; left out"))
        else:
            verdicts.append(Verdict(e, "noisy", 1 / excess, f"noisy: {words}; counts less"))
    return verdicts


def _drift(group: list[Frame]) -> list[Verdict]:
    """Electrodes whose values wander from the first to the last third of the quiet frames."""
    if len(group) < _REPEATS:
        return []
    pattern, volts = group[0].pattern, _finite(np.stack([frame.voltages for frame in group]))
    third = len(volts) // 3
    change = _mean(volts[-third:]) - _mean(volts[:third])
    noise = _mean(np.diff(volts, axis=0) ** 2) / third  # of such a change squared, were there only noise
    floor = _FLOOR * _rms(volts)
    guilty, core = _blame(pattern, change**2, _SCATTER, _SCATTER * floor)
    verdicts = []
    for e, wander in guilty.items():
        if wander <= _SCATTER * _rms(np.sqrt(noise[_involves(pattern, e)])):
            continue  # a noisy electrode, not a drifting one
        excess = wander / max(core, floor)
        words = f"drifting: its values wander by {volts_in_words(wander)} at rest, {excess:.0f} times the others'"
        verdicts.append(Verdict(e, "drifting", 1 / excess, words + "; counts less"))
    return verdicts


def _columns(group: list[Frame], touched: list[Frame]) -> list[tuple[Floats, bool]]:
    """The data (n_meas, n) to hold against a network: the quiet mean, the frames, and their changes against it."""
    quiet = _mean(np.stack([_finite(frame.voltages) for frame in group]))
    if not touched:
        return [(quiet[:, None], False)]
    chosen = [touched[k] for k in np.unique(np.linspace(0, len(touched) - 1, _MOST_COLUMNS).astype(int))]
    currents = _mean(np.stack([_currents(frame) for frame in group]))
    frames = []
    for frame in chosen:  # as if driven by the quiet frames' currents
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = np.where(_currents(frame) != 0, currents / _currents(frame), np.nan)
        frames.append(_finite(frame.voltages * factor))
    values = np.column_stack(frames)
    return [(quiet[:, None], False), (values, False), (values - quiet[:, None], True)]


def _inconsistent(pattern: DrivePattern, group: list[Frame], volts: Floats, changes: bool, bad: list[int]) -> list[Verdict]:
    """Electrodes whose values contradict every network; `bad` ones are known already."""
    quiet = _mean(np.stack([_finite(frame.voltages) for frame in group]))
    fit = NetworkFit(pattern, _mean(np.stack([_currents(frame) for frame in group])), volts)
    used = [int(e) for e in np.unique(pattern.quadruples) if e not in bad]
    out = list(bad)
    if not _worth_a_look(fit, volts, changes, bad, used):
        return []

    def gain(electrode: int) -> tuple[float, int]:
        """What the electrode adds to the misfit of those that are not `out`: squares and degrees of freedom."""
        others = [e for e in out if e != electrode]
        whole, rest = fit.misfit(fit.without(others)), fit.misfit(fit.without([*others, electrode]))
        return max(whole.squares - rest.squares, 0.0), whole.freedom - rest.freedom

    for _ in range(max(1, len(used) // 4)):
        gains = {e: gain(e) for e in _suspects(fit, out, used)}
        # the most significant: a high excess, told by many measurements
        scores = {e: squares / np.sqrt(freedom) for e, (squares, freedom) in gains.items() if freedom > 0}
        if not scores:
            break
        out.append(max(scores, key=lambda e: scores[e]))
    core = fit.misfit(fit.without(out))
    if core.freedom <= 0:
        return []
    floor = max(core.rms, _FLOOR * _rms(quiet))
    verdicts = []
    for e in [e for e in reversed(out) if e not in bad]:  # the least guilty first
        squares, freedom = gain(e)
        error = float(np.sqrt(squares / freedom)) if freedom > 0 else 0.0
        if error <= _SUSPECT * floor:
            out.remove(e)
            continue
        own, at_rest = _rms(volts[fit.with_only(e)]), _rms(quiet[fit.with_only(e)])
        times = f"{error / floor:.0f} times the others'"
        if error > _NOISE_SHARE * own and (not changes or error > _DEAD * at_rest):
            what = "changes" if changes else "values"
            words = (
                f"open: its {what} are noise ({volts_in_words(error)} fit no resistive sheet, {times}); check its contact; left out"
            )
            verdicts.append(Verdict(e, "open", 0.0, words))
        elif changes and error > _UNEVEN * floor:
            words = f"noisy: its changes break reciprocity by {volts_in_words(error)}, {times}; counts less"
            verdicts.append(Verdict(e, "noisy", floor / error, words))
    return verdicts


def _worth_a_look(fit: NetworkFit, volts: Floats, changes: bool, bad: list[int], used: list[int]) -> bool:
    """A quick way out for data in order: all fit a network well, or about equally well."""
    kept = fit.without(bad)
    whole = fit.misfit(kept)
    if whole.freedom <= 0:
        return False
    if changes:
        left = np.abs(fit.residuals(kept)[kept])
        return _rms(left) > _EVEN * 1.48 * float(np.median(left))
    signals = [_rms(volts[own]) for e in used if (own := fit.with_only(e) & kept).any()]
    return bool(np.sqrt(whole.squares / volts.shape[1]) > _NOISE_SHARE * min(signals))


def _electrode_errors(groups: dict[DrivePattern, list[Frame]], bad: list[int], n_elec: int) -> Floats:
    """Root mean square residual (n_elec,) of the quiet measurements that each electrode takes part in (V)."""
    squares: list[list[float]] = [[] for _ in range(n_elec)]
    for pattern, group in groups.items():
        quiet = _mean(np.stack([_finite(frame.voltages) for frame in group]))
        fit = NetworkFit(pattern, _mean(np.stack([_currents(frame) for frame in group])), quiet)
        kept = fit.without(bad)
        misfit = fit.misfit(kept)
        if misfit.freedom <= 0:
            continue
        left = fit.residuals(kept)[:, 0] ** 2 * (kept.sum() / misfit.freedom)
        for e in range(n_elec):
            squares[e] += left[kept & _involves(pattern, e)].tolist()
    return np.array([np.sqrt(np.mean(own)) if own else np.nan for own in squares])


def _suspects(fit: NetworkFit, removed: list[int], used: list[int]) -> list[int]:
    """The electrodes worth taking out next: all of a few, or those with the largest residuals of many."""
    left = [e for e in used if e not in removed]
    if len(left) <= 16:
        return left
    squares = (fit.residuals(fit.without(removed)) ** 2).mean(axis=1)
    means = {e: float(np.nanmean(own)) for e in left if np.isfinite(own := squares[_involves(fit.pattern, e)]).any()}
    return sorted(means, key=lambda e: -means[e])[:6]


def _levels(groups: dict[DrivePattern, list[Frame]], bad: list[int]) -> tuple[float, float, float]:
    """Noise from repeats, reciprocity error and signal, of the usable electrodes (V)."""
    squares, freedom, values = 0.0, 0, []
    reciprocity, checks = 0.0, 0
    for pattern, group in groups.items():
        usable = ~np.isin(pattern.quadruples, bad).any(axis=1)
        volts = _finite(np.stack([frame.voltages for frame in group]))[:, usable]
        mean = _mean(volts)
        values.append(mean)
        squares += float(np.nansum((volts - mean) ** 2))
        freedom += int(np.maximum(np.isfinite(volts).sum(axis=0) - 1, 0).sum())
        fit = NetworkFit(pattern, _currents(group[0]), _mean(_finite(np.stack([frame.voltages for frame in group]))))
        misfit = fit.misfit(fit.without(bad))
        reciprocity, checks = reciprocity + misfit.squares, checks + misfit.freedom
    noise = float(np.sqrt(squares / freedom)) if freedom else float("nan")
    return noise, float(np.sqrt(reciprocity / checks)) if checks > 0 else float("nan"), _rms(np.concatenate(values))
