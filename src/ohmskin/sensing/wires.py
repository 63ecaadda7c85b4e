"""Wires that are exchanged, or touch each other, while the loop runs.

What that changes follows from the two-terminal resistances of the quiet skin alone, exactly: an exchange renumbers
them, and a bridge from a to b of resistance R takes V_ij^2 / (F_ab + R) off each F_ij, where V_ij is the voltage that
one ampere from a to b makes between i and j. Contacts may explain most of that by chance, but never all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Floats
from ohmskin.contacts.information import Errors, Information
from ohmskin.scan import Difference, Pairs
from ohmskin.sensing.diagnosis import Cause
from ohmskin.sensing.model import SkinModel

_RIDGE = 1e-9  # of the information on a resistance, so that none is estimated without
_SURE = 10.0  # squared size of data over their noise, from which on they show a fault of the wires
_UNEXPLAINED = 0.01  # share of the data that such a fault leaves at most
_STILL = 0.3  # the same of one that was found before: a touch beside it changes little
_BRIDGED = 0.5  # share of a short's effect that a bridge has at least; presses resemble weaker ones
_MOST = 32  # electrodes, beyond which there are too many pairs to try


@dataclass(frozen=True, eq=False)
class WireFault:
    """A fault of two wires.

    Args:
        cause: Its kind, ``exchanged`` or ``shorted``, and electrodes.
        change: (n_pairs,) what it changes of the two-terminal resistances (ohm).
    """

    cause: Cause
    change: Floats

    def repaired(self, scan: Difference, pairs: Pairs) -> Difference:
        """A scan without what a bridge does to the others; an exchange of two wires does nothing to these.

        Args:
            scan: What has changed.
            pairs: Of electrodes.
        """
        return scan.minus(self.change, pairs) if self.cause.kind == "shorted" else scan


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
    def exchanges(self) -> Floats:
        """(n_pairs, n_pairs) what the exchange of each two wires changes of the two-terminal resistances (ohm)."""
        pairs, changes = self._pairs, np.empty((len(self._pairs), len(self._pairs)))
        for row, ends in zip(changes, pairs.ends, strict=True):
            order = np.arange(pairs.n_elec)
            order[ends] = ends[::-1]
            row[:] = self.resistances[pairs.numbers[tuple(order[pairs.ends].T)]] - self.resistances
        return changes

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

    def found(self, scans: Sequence[Difference], before: Cause | None = None) -> WireFault | None:
        """The fault that explains scans; None if none does.

        Args:
            scans: What has changed, with `power`.
            before: The fault found in the last frame: beside it, something may touch the skin.
        """
        known = [scan for scan in scans if scan.known]
        data, faults = Information.of(self._pairs, self._errors, known)[0], list[tuple[float, WireFault]]()
        for kind, changes in (("exchanged", self.exchanges), ("shorted", self.shorts)):
            shown, powers = changes @ data.misfit.vector[:-1], data.misfit.norms(changes.T) ** 2
            least = 1.0 if kind == "exchanged" else _BRIDGED
            sizes = np.clip(shown / np.maximum(powers, 1e-300), least, 1.0)
            costs = sizes * (sizes * powers - 2 * shown)
            one = int(np.argmin(costs))
            cause = Cause(kind, tuple(self._pairs.ends[one].tolist()))
            faults.append((float(costs[one]), WireFault(cause, sizes[one] * changes[one])))
        fault = min(faults, key=lambda tried: tried[0])[1]
        signal, left = data.signals(fault.change)
        most = _STILL if before == fault.cause else _UNEXPLAINED
        return fault if signal > _SURE * data.count and left < most * signal else None
