"""Information of scans about two-terminal resistances: all that contacts are fitted to, whatever the patterns driven.

Voltages of a scan change by y = A x + D z + noise: x are the changes of the two-terminal resistances (ohm) and, last,
a common relative change of all of them; z are errors that data alone cannot separate from x beforehand, such as
those of currents and contact impedances, each with a standard deviation of one. With white noise the squared misfit, z
at its best, is constant - 2 vector.x + x.matrix.x. That is sufficient: scans with errors of their own add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import sqrt

import numpy as np
from scipy.linalg import block_diag

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import whitened
from ohmskin.contacts.misfit import COMMON, FLAT, QuadraticMisfit, ridge_solution, signals
from ohmskin.contacts.whitened import ErrorTerms, Quadratic, Reduced, Scan, scaled_rows
from ohmskin.errors import DataError, PatternError
from ohmskin.scan import Difference
from ohmskin.scan.pairs import Pairs
from ohmskin.scan.pattern import joined

NO_DATA = "no finite measurement in the frame; check the device, or that the voltages do not clip"
_SIGNIFICANT = 2.0  # squared size of data over their noise, from which on a signal is significant
_UNEVEN = 3e-3  # relative change of conductivity that may have come since it was last followed
_RIDGE = 0.05  # of a voltage's information on a pair, so that no drift is estimated without information


@dataclass(frozen=True, eq=False)
class Errors:
    """How data err beside the white noise of voltages.

    Args:
        noise: Standard deviation of a difference of voltages (V).
        gain: Of the relative error of a measured current, the same in all voltages of an injection (1).
        contacts: (n_pairs, n_elec) change of two-terminal resistances with each electrode's contact impedance, for one
            standard deviation of it (ohm); None: they are known.
        model: How far the model of a contact errs, as a share of the root mean square of the data (1).
        fields: (n_pairs, k) change of two-terminal resistances with each smooth field of conductivity, for one
            standard deviation of it where the sheet drifts by one (ohm); None: it does not drift unevenly.
        uneven: By how much it does now, a relative change of conductivity (1).
    """

    noise: float
    gain: float = 0.0
    contacts: Floats | None = None
    model: float = 0.0
    fields: Floats | None = None
    uneven: float = 0.0

    def changes(self, uneven: float | None = None) -> Floats:
        """Change of two-terminal resistances (n_pairs, k) with each contact impedance, for one standard deviation of it
        (ohm); then with each smooth field, if the sheet drifts unevenly, by `uneven` (1) unless by as much as now."""
        assert self.contacts is not None
        uneven = self.uneven if uneven is None else uneven
        if self.fields is None or not uneven:
            return self.contacts
        return np.hstack([self.contacts, uneven * self.fields])

    def drift(self, data: "Information") -> tuple[Floats, Floats, Floats]:
        """What the data of one frame show of contact impedances and smooth fields, if nothing touches the skin.

        A common change of all resistances is estimated beside them, and no part of it.

        Returns:
            The likeliest change (n_pairs,) of two-terminal resistances (ohm); that in each field (k,), a relative
            change of conductivity (1); and its error.
        """
        assert self.contacts is not None
        changes, n_elec = self.changes(_UNEVEN), self.contacts.shape[1]
        rows = block_diag(changes.T, COMMON)
        shown, seen = rows @ data.misfit.vector, data.misfit.normal_products(rows) @ rows.T
        # the errors of the data hold impedances, and as much of the fields as the sheet drifts; the rest is added here
        beside = np.linalg.solve(np.eye(len(rows) - n_elec) + seen[n_elec:, n_elec:], seen[n_elec:])
        prior = np.append(np.ones(n_elec), np.full(changes.shape[1] - n_elec, 1 + (self.uneven / _UNEVEN) ** 2))
        power = np.diag(seen) - (seen[n_elec:] * beside).sum(axis=0)
        likeliest = prior * (shown - shown[n_elec:] @ beside)[:-1]
        errors = np.sqrt(np.maximum(prior * (1 - prior * power[:-1]), 0.0))
        return changes @ likeliest, _UNEVEN * likeliest[n_elec:], _UNEVEN * errors[n_elec:]

    def rises(self, data: "Information") -> Floats:
        """By how many standard deviations (n_elec,) each contact impedance has surely risen."""
        assert self.contacts is not None
        rows = block_diag(self.changes().T, COMMON)
        covariance = np.linalg.inv(data.white.normal_products(rows) @ rows.T + np.eye(len(rows)))
        likeliest = covariance @ rows @ data.white_residual.vector
        return np.asarray(likeliest / np.sqrt(np.diag(covariance)))[: self.contacts.shape[1]]


@dataclass(frozen=True, eq=False)
class Information:
    """Information of one or several scans.

    Args:
        misfit: With errors of all kinds at their best.
        white: The same if voltages erred by white noise alone, and nothing were known.
        count: Data.
        known: (n_pairs + 1,) changes that are known; None: nothing is.
    """

    misfit: QuadraticMisfit
    white: QuadraticMisfit
    count: int
    known: Floats | None = None

    @classmethod
    def of(
        cls, pairs: Pairs | int, errors: Errors, scans: Sequence[Difference], drift: Floats | None = None
    ) -> tuple["Information", "Information"]:
        """Information of scans with the same contacts, with nominal noise, and inflated by the model's error; less a
        known `drift` (n_pairs,) of the two-terminal resistances (ohm).

        Channels that are not finite are left out. Data of driven electrodes count as much less as their larger changes
        are modelled worse.

        Raises:
            DataError: If no finite datum is left.
            PatternError: If a pattern names an electrode that is not there.
        """
        pairs = Pairs.all(pairs)
        drift = np.zeros(len(pairs)) if drift is None else drift
        _, nominal, inflated, white, count = whitened.likelihood(*arguments(pairs, errors, scans), drift, 0.0)
        if not count:
            raise DataError(NO_DATA)
        alone = QuadraticMisfit(*white)
        return cls.made(nominal, alone, count), cls.made(inflated, alone, count)

    @classmethod
    def made(cls, part: Quadratic, white: QuadraticMisfit, count: int) -> "Information":
        """Information of `count` data from what compiled steps return: the squared misfit with all errors (`part`), and
        with `white` noise alone."""
        return cls(QuadraticMisfit(*part, len(part[1])), white, count)

    @classmethod
    def combined(cls, parts: Sequence["Information"]) -> "Information":
        """Sum of the information of several whose errors are independent."""
        white = _summed([part.white_residual for part in parts])
        return cls(_summed([part.misfit for part in parts]), white, sum(part.count for part in parts))

    def with_misfits(self, parts: Sequence["Information"]) -> "Information":
        """The same data as others see them that err otherwise: the sum of `parts`, white noise that of these."""
        return changed(self, misfit=_summed([part.misfit for part in parts]))

    @property
    def signal(self) -> float:
        """Root mean square of the data over their noise (1)."""
        return sqrt(max(self.white_residual.constant, 0.0) / self.count)

    @property
    def white_residual(self) -> QuadraticMisfit:
        """What is left, if voltages erred by white noise alone."""
        return self.white if self.known is None else self.white.minus(self.known)

    def minus(self, known: Floats) -> "Information":
        """The information that remains once known changes (n_pairs or n,) are subtracted."""
        known = np.ascontiguousarray(known)
        together = np.zeros(len(self.misfit.vector)) if self.known is None else self.known.copy()
        together[: len(known)] += known
        return Information(self.misfit.minus(known), self.white, self.count, together)

    def reduced_to(self, left: Reduced, known: Floats | None = None) -> "Information":
        """What a compiled step has left of it, once changes (n_pairs + 1,) are known; None: nothing is."""
        own = self.misfit
        misfit = QuadraticMisfit(own.rows, *left, own.errors, own.powers)
        return Information(misfit, self.white, self.count, known)

    def marginalised(self, directions: Floats) -> "Information":
        """The information, with changes (n_pairs or n, k) as errors, each with a standard deviation of one."""
        return Information(self.misfit.marginalised(directions), self.white, self.count, self.known)

    def marginalised_common(self, variance: float = COMMON**2) -> "Information":
        """The information, with a common relative change of all resistances of known variance (1) as an error."""
        direction = np.zeros((len(self.misfit.vector), 1))
        direction[-1] = sqrt(variance)
        return self.marginalised(direction)

    def unexplained(self, caused: Floats) -> float:
        """Share of the signal beyond noise, if that is large, that contacts (their changes, n_pairs) do not explain."""
        return self.share_unexplained(*self.signals(caused))

    def share_unexplained(self, signal: float, left: float) -> float:
        """The same, given the signal beyond noise and what is left of it, see `signals`."""
        return min(max(left / signal, 0.0), 1.0) if signal > _SIGNIFICANT * self.count else 0.0

    def signals(self, caused: Floats) -> tuple[float, float]:
        """The signal beyond noise, and what remains of it after changes of contacts (n_pairs,); squared sizes."""
        signal, left = signals(*self.misfit.part, np.ascontiguousarray(caused))
        return signal - self.count, left - self.count

    def drift(self) -> Floats:
        """Change (n_pairs,) of each two-terminal resistance that explains the data (ohm); 0 without information."""
        ridge = _RIDGE * self.white.trace / self.count
        return ridge_solution(self.misfit.rows, self.misfit.downdates, self.misfit.vector, ridge)[:-1]

    def marginalised_flat(self, directions: Floats) -> "Information":
        """The information, with changes (n_pairs or n, k) of unknown size as errors."""
        return self.marginalised(self._flat_prior(directions))

    def excluding(self, directions: Floats) -> "Information":
        """The information without changes (n_pairs or n, k), in the size of others neither."""
        unknown = self._flat_prior(directions)
        return Information(self.misfit.marginalised(unknown), self.white.marginalised(unknown), self.count, self.known)

    def _flat_prior(self, directions: Floats) -> Floats:
        """Changes (n_pairs or n, k) as large as they are where nothing is known of them."""
        sizes = self.white.norms(directions)
        return np.asarray(directions[:, sizes > 0] / (FLAT * sizes[sizes > 0]))

    def scaled(self, share: float) -> "Information":
        """The same with all errors larger: `share` of what is known."""
        misfit, rows = self.misfit, scaled_rows(self.misfit.rows, share)
        scaled = QuadraticMisfit(
            rows, sqrt(share) * misfit.downdates, share * misfit.vector, share * misfit.constant, misfit.errors
        )
        return Information(scaled, self.white, self.count, self.known)

    def norm(self, changes: Floats) -> float:
        """How large changes (n_pairs or n,) are in the data, in standard deviations of white noise."""
        return float(self.white.norms(changes[:, None])[0])


def arguments(pairs: Pairs, errors: Errors, scans: Sequence[Difference]) -> tuple[Scan, ErrorTerms]:
    """What compiled steps are given of scans whose contacts are in the same state, and of how these err.

    Raises:
        DataError: If there is none.
        PatternError: If a pattern names an electrode that is not there.
    """
    if not scans:
        raise DataError("no scan to find contacts in; give at least one")
    whole = joined(tuple(scan.pattern for scan in scans))
    if (last := whole.last) >= pairs.n_elec:
        raise PatternError(f"the pattern names electrode {last}; there are {pairs.n_elec} (0..{pairs.n_elec - 1})")
    loaded = any(scan.source_loading is not None for scan in scans)
    given = [(scan.reference, scan.source_loading, scan.volts, scan.currents) for scan in scans]
    parts = [[np.zeros(len(own[2])) if each is None else each for each in own] for own in given]
    quiet, loading, volts, amperes = parts[0] if len(scans) == 1 else map(np.concatenate, zip(*parts, strict=True))
    contacts = np.zeros((len(pairs), 0)) if errors.contacts is None else np.ascontiguousarray(errors.changes())
    if contacts.size and not pairs.whole:  # idle electrodes are many, and shunt a large sheet little
        driven = np.append(np.unique(whole.injections), np.arange(pairs.n_elec, contacts.shape[1]))
        contacts = np.ascontiguousarray(contacts[:, driven])
    four, which = whole.quadruples, whole.injection_numbers
    scan = four, which, whole.driven, amperes, volts, quiet, loading, pairs.numbers, whole.n_inj, loaded
    return scan, (errors.noise, errors.gain, errors.model, contacts)


def _summed(parts: Sequence[QuadraticMisfit]) -> QuadraticMisfit:
    """The misfit of data whose errors are their own."""
    columns, sizes, loading, quiet, starts, weights = zip(*(part.rows for part in parts), strict=True)
    begins = np.cumsum([0, *(len(own) for own in sizes)])
    loaded = any(len(own) for own in loading)
    loads = [own if len(own) else np.zeros(len(size)) for own, size in zip(loading, sizes, strict=True) if loaded]
    first = [own[:-1] + begin for own, begin in zip(starts, begins, strict=False)]
    rows = (
        np.concatenate(columns),
        np.concatenate(sizes),
        np.concatenate(loads or [np.empty(0)]),
        np.concatenate(quiet),
        np.append(np.concatenate(first), begins[-1]),
        np.concatenate(weights),
    )
    vector, constant = reduce(np.add, [part.vector for part in parts]), sum(part.constant for part in parts)
    downdates = np.concatenate([part.downdates for part in parts])
    return QuadraticMisfit(rows, downdates, vector, constant, len(downdates))
