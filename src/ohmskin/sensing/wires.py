"""Wires that are exchanged, or touch each other, while the loop runs.

What that changes follows from the two-terminal resistances of the quiet skin alone, exactly: an exchange renumbers
them, and a bridge from a to b of resistance R takes V_ij^2 / (F_ab + R) off each F_ij, where V_ij is the voltage that
one ampere from a to b makes between i and j. Contacts may explain most of that by chance, but never all.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Floats, Ints
from ohmskin.contacts.information import Errors, Information
from ohmskin.scan import Difference
from ohmskin.sensing.diagnosis import Cause, WireFault
from ohmskin.sensing.model import SkinModel

_RIDGE = 1e-9  # of the information on a resistance, so that none is estimated without
_SURE = 10.0  # squared size of data over their noise, from which on they show a fault of the wires
_UNEXPLAINED = 0.01  # share of the data that such a fault leaves at most
_STILL = 0.3  # the same of one that was found before: a touch beside it changes little
_BRIDGED = 0.5  # share of a short's effect that a bridge has at least; presses resemble weaker ones
_LESS = 0.1  # times what one exchange leaves is what two leave at most
_LARGE = 0.02  # share of the quiet skin's power by which voltages change where two exchanges are tried; few presses
_FIRSTS = 8  # likeliest exchanges beside which a second one is tried
_MOST = 32  # electrodes, beyond which there are too many pairs to try


class WireFaults:
    """The faults of any two wires of a skin.

    Args:
        known: What is known of the quiet skin.
    """

    def __init__(self, known: SkinModel) -> None:
        self._known, self._pairs, self._errors = known, known.pairs, Errors(known.white, known.gain)
        self._tried = self._pairs.whole and self._pairs.n_elec <= _MOST

    @cached_property
    def resistances(self) -> Floats:
        """(n_pairs,) two-terminal resistances of the quiet skin (ohm), as far as they have been measured."""
        patterns = {frame.pattern for frame in self._known.quiet.frames}
        rows = sp.vstack([pattern.combination(self._pairs) for pattern in patterns]).tocsr()
        quiet = np.concatenate([self._known.baseline.reference(pattern) for pattern in patterns])
        rows, quiet = rows[np.isfinite(quiet)], quiet[np.isfinite(quiet)]
        normal = (rows.T @ rows).toarray()
        normal[np.diag_indices_from(normal)] += _RIDGE * normal.trace() / len(normal)
        return np.asarray(np.linalg.solve(normal, rows.T @ quiet))

    @cached_property
    def _renumbered(self) -> Ints:
        """(n_pairs, n_pairs) which pair each pair is once the wires of two electrodes are exchanged."""
        pairs, renumbered = self._pairs, np.empty((len(self._pairs), len(self._pairs)), int)
        for row, ends in zip(renumbered, pairs.ends, strict=True):
            order = np.arange(pairs.n_elec)
            order[ends] = ends[::-1]
            row[:] = pairs.numbers[tuple(order[pairs.ends].T)]
        return renumbered

    @cached_property
    def exchanges(self) -> Floats:
        """(n_pairs, n_pairs) what the exchange of each two wires changes of the two-terminal resistances (ohm)."""
        return np.asarray(self.resistances[self._renumbered] - self.resistances)

    @cached_property
    def shorts(self) -> Floats:
        """(n_pairs, n_pairs) what a bridge without resistance between each two wires changes of them (ohm)."""
        table = np.append(self.resistances, 0.0)[self._pairs.numbers]
        np.fill_diagonal(table, 0.0)
        a, b = self._pairs.ends.T[:, :, None]
        i, j = self._pairs.ends.T[:, None, :]
        volts = (table[i, b] + table[j, a] - table[i, a] - table[j, b]) / 2
        own = self.resistances[:, None]
        return np.asarray(np.where(own > 0, -(volts**2) / np.where(own > 0, own, 1.0), 0.0))

    def power(self, scans: Sequence[Difference]) -> float:
        """Mean square (V2) of the changes of scans; 0 if no fault of wires could be found in them."""
        volts = [scan.volts[np.isfinite(scan.volts)] for scan in scans if self._tried]
        count = sum(map(len, volts))
        power = sum(float(own @ own) for own in volts) / max(count, 1)
        return power if power > _SURE * self._errors.noise**2 else 0.0

    def found(
        self, scans: Sequence[Difference], before: WireFault | None = None, thorough: bool = False
    ) -> WireFault | None:
        """The fault that explains scans; None if none does.

        Args:
            scans: What has changed, with `power`.
            before: The fault found in the last frame: beside it, something may touch the skin.
            thorough: Whether any two exchanges are tried if no contacts could change as much: up to fifteen times as
                long with 16 electrodes.
        """
        data = Information.of(self._pairs, self._errors, [scan for scan in scans if scan.known])[0]
        if before is not None and _explains(before, data, _UNEXPLAINED):  # few injections may not show all of it
            return before
        exchanged, costs = _likeliest("exchanged", self._pairs.ends, self.exchanges, data)
        shorted, more = _likeliest("shorted", self._pairs.ends, self.shorts, data)
        fault = shorted if more.min() < costs.min() else exchanged
        signal, quiet = data.signals(fault.change)[0], data.misfit.norms(self.resistances[:, None])[0] ** 2
        firsts = len(costs) if thorough and signal > quiet else _FIRSTS if signal > _LARGE * quiet else 0
        for start in range(0, firsts, _FIRSTS):
            left = data.signals(fault.change)[1]
            if left < _SURE * data.count or (start and _explains(fault, data, _UNEXPLAINED)):
                break
            two = self._two_exchanges(np.argsort(costs)[start:][:_FIRSTS], data)
            fault = two if data.signals(two.change)[1] < _LESS * left else fault
        if _explains(fault, data, _UNEXPLAINED):
            return fault
        return before if before is not None and _explains(before, data, _STILL) else None

    def _two_exchanges(self, firsts: Ints, data: Information) -> WireFault:
        """The likeliest two exchanges, one of them among the `firsts` (numbers of pairs)."""
        ends, renumbered = self._pairs.ends, self._renumbered
        both = renumbered[firsts[:, None, None], renumbered[None]].reshape(-1, len(ends))
        wires = np.hstack([np.repeat(ends[firsts], len(ends), axis=0), np.tile(ends, (len(firsts), 1))])
        return _likeliest("exchanged", wires, self.resistances[both] - self.resistances, data)[0]


def _explains(fault: WireFault, data: Information, unexplained: float) -> bool:
    """Whether a fault leaves at most that share of data."""
    signal, left = data.signals(fault.change)
    return signal > _SURE * data.count and left < unexplained * signal


def _likeliest(kind: str, wires: Ints, changes: Floats, data: Information) -> tuple[WireFault, Floats]:
    """The fault of some (n, k) wires each, and its changes (n, n_pairs), that explains data best; the costs (n,)."""
    shown, powers = changes @ data.misfit.vector[:-1], data.misfit.norms(changes.T) ** 2
    sizes = np.clip(shown / np.maximum(powers, 1e-300), 1.0 if kind == "exchanged" else _BRIDGED, 1.0)
    costs = sizes * (sizes * powers - 2 * shown)
    one = int(np.argmin(costs))
    return WireFault(Cause(kind, tuple(wires[one].tolist())), sizes[one] * changes[one]), costs
