"""Remedies: the least that is left out of contradictory data to make the rest agree with a resistive network."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from ohmskin.arrays import Bools, Floats
from ohmskin.scan.coherence import Coherence, NetworkData
from ohmskin.sensing.diagnosis import MAINS, Cause

_LIMIT, _SIGMAS = 1.3, 6.0  # excess of a misfit that is not doubted, and standard deviations of its noise
_CLOSE = 4.0  # the same where something was taken off: what is left of it would look like a contact
_DEGREE = 4  # of what is common to all voltages, over the time of a scan: half a period of hum to a thousandth
_SPIKES = 3  # values that may be left out of one frame
_TESTED, _AS_WELL = (
    1e-3,
    9.0,
)  # least of a value that others do not determine; squared misfit by which two are distinguished
_SUSPECTS = 4  # electrodes that are tried, of those with the largest residuals
_GROSS = 15.0  # times by which a loose wire's data disagree more than others: a touch that moves within a scan less
_LEFT = 0.3  # share of the degrees of freedom that must be left to show that the rest agrees
_PRICE = 6.0  # squared misfit that a datum left out must save


@dataclass(frozen=True, eq=False)
class Remedy:
    """What makes data agree.

    Args:
        cause: What was wrong.
        kept: (n_meas,) which data are used.
        fit: How well these agree.
        off: (n_meas,) what is taken off them (V); None: nothing.
    """

    cause: Cause
    kept: Bools
    fit: Coherence
    off: Floats | None = None


def limit(freedom: int) -> float:
    """Excess of a misfit that is not doubted."""
    return _LIMIT * (1 + _SIGMAS * float(np.sqrt(2 / max(freedom, 1))))


def agrees(fit: Coherence) -> bool:
    """Whether data contradict no network."""
    return fit.excess < limit(fit.freedom)


def likeliest(data: NetworkData, kept: Bools, whole: Coherence, times: Floats, most: int) -> Remedy | None:
    """The likeliest of what makes data agree, if anything does: what is left out counts against it.

    Args:
        data: Scans of one moment.
        kept: (n_meas,) which of them are used.
        whole: How well these agree.
        times: (n_meas,) when each was converted, from the start of its scan (s).
        most: Electrodes that may be left out.
    """
    tried = without_spikes(data, kept), _without_an_injection(data, kept, whole), without_offset(data, kept, times)
    one = _without_electrodes(data, kept, whole, min(most, 1))
    return _best((*tried, one)) or _without_electrodes(data, kept, whole, most)


def without_offset(data: NetworkData, kept: Bools, times: Floats) -> Remedy | None:
    """Without an offset of each scan, or hum, the same on all its voltages.

    Args:
        data: Scans of one moment.
        kept: (n_meas,) which of them are used.
        times: (n_meas,) when each was converted, from the start of its scan (s).
    """
    tried = [_without(data, kept, np.ones(len(kept)))]
    for mains in MAINS:
        phase = 2 * np.pi * mains * times
        tried.append(_without(data, kept, np.cos(phase), np.sin(phase)))
    # of a device whose scans take another time than is known of it
    tried.append(_without(data, kept, *legvander(2 * times / max(times.max(), 1e-12) - 1, _DEGREE).T))
    return _best(tried)


def _best(tried: Iterable[Remedy | None]) -> Remedy | None:
    """That which makes data agree best, where what is left out, or may be of any size, counts against it."""
    found = [one for one in tried if one is not None]
    return min(found, key=lambda one: one.fit.squares - _PRICE * one.fit.freedom, default=None)


def _without(data: NetworkData, kept: Bools, *waves: Floats) -> Remedy | None:
    """Without what adds to all voltages (n_meas,) like these waves, of any size in each scan."""
    own = data.scan == np.arange(data.scan[-1] + 1)[:, None]
    added = np.vstack([own * wave for wave in waves])
    fit = data.coherence(kept, added)
    off = fit.added @ added
    close = fit.excess < 1 + _CLOSE * np.sqrt(2 / max(fit.freedom, 1)) and fit.freedom >= len(waves)
    smaller = np.abs(off[kept]).max() < data.largest(kept)
    return Remedy(Cause("offset"), kept, fit, off) if close and smaller else None


def _without_electrodes(data: NetworkData, kept: Bools, whole: Coherence, most: int) -> Remedy | None:
    """Without the fewest electrodes, at most so many."""
    out: tuple[int, ...] = ()
    enough, gross = _LEFT * whole.freedom, whole.noise / _GROSS
    while len(out) < most and whole.freedom > enough:
        squares = whole.residuals**2
        shares = {e: squares[kept & data.uses(e)].mean() for e in np.unique(data.quadruples[kept]).tolist()}
        rests = {e: kept & ~data.uses(e) for e in sorted(shares, key=lambda e: -shares[e])[:_SUSPECTS]}
        tried = {e: data.coherence(rest) for e, rest in rests.items() if rest.any()}
        if not tried:
            break
        best = min(tried, key=lambda e: tried[e].noise)
        out, kept, whole = (*out, best), rests[best], tried[best]
        if agrees(whole) and whole.freedom > enough and whole.noise < gross:
            return Remedy(Cause("open", tuple(sorted(out))), kept, whole)
    return None


def without_spikes(data: NetworkData, kept: Bools) -> Remedy | None:
    """Without the fewest values, and those that may be wrong as well in place of one of them."""
    projection, left = data.projection(kept)
    for _ in range(_SPIKES):
        power = np.diag(projection)
        saved = np.where(power > _TESTED, left**2 / np.maximum(power, _TESTED), 0.0)
        worst = int(np.argmax(saved))
        if saved[worst] < _AS_WELL:  # none stands out
            return None
        kept = kept & (saved < max(saved[worst] - _AS_WELL, _AS_WELL))
        share = projection[worst] / power[worst]
        left, projection = left - left[worst] * share, projection - np.outer(share, projection[worst])
        if agrees(fit := data.coherence(kept)):
            return Remedy(Cause("spikes"), kept, fit)
    return None


def _without_an_injection(data: NetworkData, kept: Bools, whole: Coherence) -> Remedy | None:
    """Without the injection that stands out most."""
    kept = kept & (data.injection != np.argmax(np.bincount(data.injection, whole.residuals**2)))
    rest = data.coherence(kept)
    return Remedy(Cause("injection"), kept, rest) if agrees(rest) else None
