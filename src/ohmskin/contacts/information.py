"""What scans say of two-terminal resistances: all that contacts are fitted to, whatever the patterns driven.

Voltages of a scan change by y = A x + D z + noise: x are the changes of the two-terminal resistances (ohm) and, last,
a common relative change of all of them; z are errors that the data themselves cannot tell from x beforehand, such as
those of currents and contact impedances, each with a standard deviation of one. With white noise the squared misfit, z
at its best, is constant - 2 vector.x + x.matrix.x. That is sufficient: scans with errors of their own add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ohmskin.arrays import Bools, Floats, Ints
from ohmskin.errors import DataError
from ohmskin.scan import Difference, pair_index
from ohmskin.scan.pairs import n_pairs

_UNSAID = 1e-4  # share of its size in the data by which a direction of which nothing is known may still be seen


@dataclass(frozen=True, eq=False)
class Errors:
    """How data err beside the white noise of voltages.

    Args:
        noise: Standard deviation of a difference of voltages (V).
        gain: Of the relative error of a measured current, the same in all voltages of an injection (1).
        contacts: (n_pairs, n_elec) change of two-terminal resistances with each electrode's contact impedance, for one
            standard deviation of it (ohm); None: they are known.
        model: How far the model of a contact errs, as a share of the root mean square of the data (1).
    """

    noise: float
    gain: float = 0.0
    contacts: Floats | None = None
    model: float = 0.0

    def drift(self, scans: Sequence[Difference]) -> Floats:
        """Likeliest change (n_pairs,) of two-terminal resistances by contacts, if nothing touches the skin (ohm)."""
        assert self.contacts is not None
        whole = [scan.currents[:, None] * (scan.combination(self.contacts.shape[1]) @ self.contacts) for scan in scans]
        rows, volts = np.vstack(whole), np.concatenate([scan.volts for scan in scans])
        known = np.isfinite(volts) & np.isfinite(rows).all(axis=1)
        rows, volts = rows[known] / self.noise, volts[known] / self.noise
        return np.asarray(self.contacts @ np.linalg.solve(rows.T @ rows + np.eye(rows.shape[1]), rows.T @ volts))


@dataclass(frozen=True, eq=False)
class Information:
    """What one or several scans say, in units of the noise.

    Args:
        rows: (n_rows, n + 1), n = n_pairs + 1: the squared misfit of x is |rows (x, -1)|^2.
        plain: (n_meas, n + 1) the same if voltages erred by white noise alone.
    """

    rows: Floats
    plain: Floats

    @classmethod
    def of(cls, n_elec: int, errors: Errors, scans: Sequence[Difference]) -> tuple["Information", "Information"]:
        """What scans say whose contacts are in the same state, and the same wary: the model's error is noise, too.

        Channels that are not finite are left out. Data of driven electrodes count as much less as their larger changes
        are modelled worse.

        Raises:
            DataError: If no finite datum is left.
        """
        if not scans:
            raise DataError("no scan to find contacts in; give at least one")
        four = np.concatenate([scan.pattern.quadruples for scan in scans])
        driven = np.concatenate([scan.pattern.driven for scan in scans])
        volts = np.concatenate([scan.volts for scan in scans])
        amperes = np.concatenate([scan.currents for scan in scans])
        starts = np.cumsum([0, *(scan.pattern.n_inj for scan in scans)])
        which = np.concatenate([scan.pattern.measurements[:, 0] + n for scan, n in zip(scans, starts, strict=False)])
        zeros = [np.zeros(scan.pattern.n_meas) for scan in scans]
        quiet, loading = (
            np.concatenate([own if own is not None else zero for own, zero in zip(given, zeros, strict=True)])
            for given in ([scan.reference for scan in scans], [scan.source_loading for scan in scans])
        )
        known = np.isfinite(volts) & np.isfinite(amperes)
        if not known.any():
            raise DataError("no finite measurement in the frame; check the device, or that the voltages do not clip")
        (a, b, c, d), which, driven = four[known].T, which[known], driven[known]
        share = _shares(volts[known], driven, errors) / errors.noise
        amperes, at, count = amperes[known] * share, np.arange(len(a)), n_pairs(n_elec)
        plain = np.zeros((len(a), count + 2))
        for one, other, sign in ((a, d, 0.5), (b, c, 0.5), (a, c, -0.5), (b, d, -0.5)):
            distinct = one != other  # a driven electrode that is also measured: F_ii = 0
            plain[at[distinct], pair_index(one[distinct], other[distinct], n_elec)] += sign * amperes[distinct]
        plain[at, pair_index(a, b, n_elec)] -= amperes * loading[known]
        plain[:, -2], plain[:, -1] = np.nan_to_num(quiet[known]) * share, volts[known] * share
        larger = float(np.hypot(1.0, errors.model * np.sqrt(np.mean(plain[:, -1] ** 2))))
        contacts = None
        if errors.contacts is not None:
            contacts = plain[:, :-2] @ errors.contacts
        told, wary = (_whitened(plain / by, which, errors.gain, contacts, by) for by in (1.0, larger))
        return cls(told, plain), cls(wary, plain / larger)

    @classmethod
    def together(cls, parts: Sequence["Information"]) -> "Information":
        """What several say whose errors are their own."""
        return cls(np.vstack([part.rows for part in parts]), np.vstack([part.plain for part in parts]))

    @cached_property
    def matrix(self) -> Floats:
        """(n_pairs, n_pairs) curvature of the squared misfit, halved."""
        pairs = self.rows[:, :-2]
        return np.asarray(pairs.T @ pairs)

    @property
    def vector(self) -> Floats:
        """(n_pairs,) its downhill gradient at nothing, halved."""
        return np.asarray(self.rows[:, -1] @ self.rows[:, :-2])

    @property
    def constant(self) -> float:
        """The squared misfit of nothing."""
        return float(self.rows[:, -1] @ self.rows[:, -1])

    @property
    def signal(self) -> float:
        """Root mean square of the data over their noise (1)."""
        return float(np.sqrt(np.mean(self.plain[:, -1] ** 2)))

    def less(self, known: Floats) -> "Information":
        """What is left to say once changes (n_pairs or n,) are known to be a part of it."""
        rows, plain = self.rows.copy(), self.plain.copy()
        rows[:, -1] -= rows[:, : len(known)] @ known
        plain[:, -1] -= plain[:, : len(known)] @ known
        left = Information(rows, plain)
        if "matrix" in self.__dict__:
            left.__dict__["matrix"] = self.matrix
        return left

    def without(self, directions: Floats) -> "Information":
        """What is said beside changes (n_pairs or n, k), each with a standard deviation of one."""
        return Information(_beside(self.rows, self.rows[:, : len(directions)] @ directions), self.plain)

    def beside(self, directions: Floats) -> "Information":
        """What is said beside changes (n_pairs or n, k) of which nothing is known."""
        scale = np.linalg.norm(self.plain[:, : len(directions)] @ directions, axis=0)
        seen = self.rows[:, : len(directions)] @ (directions[:, scale > 0] / scale[scale > 0])
        return Information(_beside(self.rows, seen / _UNSAID), self.plain)

    def times(self, share: float) -> "Information":
        """The same with all errors larger: `share` of what is known."""
        scaled = Information(np.sqrt(share) * self.rows, self.plain)
        scaled.__dict__["matrix"] = share * self.matrix
        return scaled

    def size(self, changes: Floats) -> float:
        """How large changes (n_pairs,) are in the data, in standard deviations of white noise."""
        return float(np.linalg.norm(self.plain[:, : len(changes)] @ changes))


def _whitened(plain: Floats, which: Ints, gain: float, contacts: Floats | None, larger: float) -> Floats:
    """Rows of equal noise, those of an injection behind each other, beside errors of currents and contacts (n, k)."""
    rows = plain
    contacts = None if contacts is None else contacts / larger
    if gain > 0:
        errors, first = gain * plain[:, -2], np.flatnonzero(np.diff(which, prepend=-1))
        squares = np.add.reduceat(errors**2, first)
        shrink = (1 - 1 / np.sqrt(1 + squares)) / np.maximum(squares, 1e-300)
        inside = np.repeat(np.arange(len(first)), np.diff(first, append=len(plain)))

        def beside(columns: Floats) -> Floats:
            seen = np.add.reduceat(errors[:, None] * columns, first, axis=0) * shrink[:, None]
            return np.asarray(columns - errors[:, None] * seen[inside])

        rows, contacts = beside(rows), None if contacts is None else beside(contacts)
    return rows if contacts is None else _beside(rows, contacts)


def _beside(rows: Floats, errors: Floats) -> Floats:
    """(I + E E^T)^(-1/2) rows, for errors E (n_rows, k)."""
    if not errors.shape[1]:
        return rows
    squares, turn = np.linalg.eigh(errors.T @ errors)
    root = np.sqrt(1 + np.maximum(squares, 0.0))
    return np.asarray(rows - errors @ ((turn / (root * (root + 1))) @ (turn.T @ (errors.T @ rows))))


def _shares(volts: Floats, driven: Bools, errors: Errors) -> Floats:
    """How much each datum (n_meas,) counts (1)."""
    if driven.all() or not driven.any():
        return np.ones(len(volts))
    squares = (float(np.mean(volts[kind] ** 2)) for kind in (~driven, driven))
    usual, theirs = (float(np.hypot(errors.noise, errors.model * np.sqrt(square))) for square in squares)
    return np.where(driven, min(1.0, usual / theirs), 1.0)
