"""Which electrodes contradict every resistive network (`NetworkFit`), and how far the data of the others do."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.scan.frame import Frame
from ohmskin.scan.network import NetworkFit
from ohmskin.scan.quality import Verdict, in_words
from ohmskin.scan.repeats import Repeats, finite, known_mean, rms

ABSENT = 0.08  # share of the typical signal below which nothing arrives
NOISE_SHARE = 0.3  # share of an electrode's own signal that contradicts the network, above which it is of no use
FLOOR = 1e-4  # error below which electrodes are not compared, as a share of the signal
_SUSPECT = 2.5  # times the other electrodes' error up to which an electrode is in order
_UNEVEN = 6.0  # times the others' error above which an electrode counts less; intact tanks stay below
_EVEN = 1.3  # unevenness of residuals, rms over median, up to which they are taken for plain noise
_MOST_COLUMNS = 24


def data_columns(quiet: Repeats, touched: Sequence[Frame]) -> list[tuple[Floats, bool]]:
    """The data (n_meas, n) to hold against a network: the quiet mean, the frames, and their changes against it.

    Returns:
        Each with whether it holds changes.
    """
    mean = quiet.mean[:, None]
    if not touched:
        return [(mean, False)]
    some = [touched[k] for k in np.unique(np.linspace(0, len(touched) - 1, _MOST_COLUMNS).astype(int))]
    own = np.column_stack([frame.measurement_currents for frame in some])
    with np.errstate(invalid="ignore", divide="ignore"):  # as if driven by the quiet frames' currents
        factor = np.where(own != 0, quiet.currents[:, None] / own, np.nan)
        values = finite(np.column_stack([frame.voltages for frame in some]) * factor)
    return [(mean, False), (values, False), (values - mean, True)]


def inconsistent(quiet: Repeats, volts: Floats, changes: bool, bad: list[int]) -> Iterator[Verdict]:
    """Electrodes whose values contradict every network; `bad` ones are known already."""
    fit = NetworkFit(quiet.pattern, quiet.currents, volts)
    used = [int(e) for e in np.unique(quiet.pattern.quadruples) if e not in bad]
    out = list(bad)
    if not _worth_a_look(fit, volts, changes, bad, used):
        return

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
        return
    floor = max(core.rms, FLOOR * rms(quiet.mean))
    for e in [e for e in reversed(out) if e not in bad]:  # the least guilty first
        squares, freedom = gain(e)
        error = float(np.sqrt(squares / freedom)) if freedom > 0 else 0.0
        if error <= _SUSPECT * floor:
            out.remove(e)
            continue
        own, at_rest = rms(volts[fit.with_only(e)]), rms(quiet.mean[fit.with_only(e)])
        times = f"{error / floor:.0f} times the others'"
        if error > NOISE_SHARE * own and (not changes or error > ABSENT * at_rest):
            noise = f"its {'changes' if changes else 'values'} are noise"
            why = f"({in_words(error)} fit no resistive sheet, {times})"
            yield Verdict(e, "open", 0.0, f"open: {noise} {why}; check its contact; left out")
        elif changes and error > _UNEVEN * floor:
            words = f"noisy: its changes violate reciprocity by {in_words(error)}, {times}; lower weight"
            yield Verdict(e, "noisy", floor / error, words)


def _worth_a_look(fit: NetworkFit, volts: Floats, changes: bool, bad: list[int], used: list[int]) -> bool:
    """A quick way out for data in order: all fit a network well, or about equally well."""
    kept = fit.without(bad)
    whole = fit.misfit(kept)
    if whole.freedom <= 0:
        return False
    if changes:
        left = np.abs(fit.residuals(kept)[kept])
        return rms(left) > _EVEN * 1.48 * float(np.median(left))
    signals = [rms(volts[own]) for e in used if (own := fit.with_only(e) & kept).any()]
    return bool(np.sqrt(whole.squares / volts.shape[1]) > NOISE_SHARE * min(signals))


def _suspects(fit: NetworkFit, removed: list[int], used: list[int]) -> list[int]:
    """The electrodes worth taking out next: all of a few, or those with the largest residuals of many."""
    left = [e for e in used if e not in removed]
    if len(left) <= 16:
        return left
    squares = (fit.residuals(fit.without(removed)) ** 2).mean(axis=1)
    means = {e: float(np.nanmean(own)) for e in left if np.isfinite(own := squares[fit.pattern.uses(e)]).any()}
    return sorted(means, key=lambda e: -means[e])[:6]


def electrode_errors(groups: Iterable[Repeats], bad: list[int], n_elec: int) -> Floats:
    """Root mean square residual (n_elec,) of the quiet measurements that each electrode takes part in (V)."""
    squares: list[list[float]] = [[] for _ in range(n_elec)]
    for group in groups:
        kept = group.network.without(bad)
        misfit = group.network.misfit(kept)
        if misfit.freedom <= 0:
            continue
        left = group.network.residuals(kept)[:, 0] ** 2 * (kept.sum() / misfit.freedom)
        for e in range(n_elec):
            squares[e] += left[kept & group.pattern.uses(e)].tolist()
    return np.array([np.sqrt(np.mean(own)) if own else np.nan for own in squares])


def noise_levels(groups: Iterable[Repeats], bad: list[int]) -> tuple[float, float, float]:
    """Noise from repeats, reciprocity error and signal, of the usable electrodes (V)."""
    squares, freedom, values = 0.0, 0, []
    reciprocity, checks = 0.0, 0
    for group in groups:
        volts = group.voltages[:, ~group.pattern.uses(bad)]
        mean = known_mean(volts)
        values.append(mean)
        squares += float(np.nansum((volts - mean) ** 2))
        freedom += int(np.maximum(np.isfinite(volts).sum(axis=0) - 1, 0).sum())
        misfit = group.network.misfit(group.network.without(bad))
        reciprocity, checks = reciprocity + misfit.squares, checks + misfit.freedom
    noise = float(np.sqrt(squares / freedom)) if freedom else float("nan")
    return noise, float(np.sqrt(reciprocity / checks)) if checks > 0 else float("nan"), rms(np.concatenate(values))
