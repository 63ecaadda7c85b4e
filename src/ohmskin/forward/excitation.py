"""What drives the electrodes: given currents, given voltages, and a source with resistance in its path.

All of it is algebra on the transfer resistances S, and so are its derivatives: for currents c and d that sum to zero,

    c . dS d = -1/2 sum_{i<j} (c_i d_j + c_j d_i) dR_ij,

so that the derivative by conductivity or contact impedance is a matrix by pairs times the sensitivity of the pairs.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints, real
from ohmskin.errors import ModelError
from ohmskin.forward.transfer import TransferModel
from ohmskin.scan import Difference, DrivePattern, all_pairs


@dataclass(frozen=True, eq=False)
class Response:
    """Currents and potentials of all electrodes, for any number of excitations.

    The derivatives by the two-terminal resistances R_ij, `..._by_pairs`, give every sensitivity: multiplied by
    `TransferModel.pair_sensitivity` that to conductivity, by `pair_contact_sensitivity` that to contact impedance.

    Args:
        currents: (n_drive, n_elec) into the skin (A).
        potentials: (n_drive, n_elec) of the electrodes (V); with mean zero if currents are given.
        current_weights: (n_drive, n_elec, n_elec) a with dI = a . dS I for each electrode; zero-sum.
        potential_weights: Likewise for potentials.
    """

    currents: Floats
    potentials: Floats
    current_weights: Floats
    potential_weights: Floats

    @cached_property
    def currents_by_pairs(self) -> Floats:
        """d currents / d R_ij (n_drive, n_elec, n_pairs) in A/ohm."""
        return by_pairs(self.current_weights, self.currents[:, None])

    @cached_property
    def potentials_by_pairs(self) -> Floats:
        """d potentials / d R_ij (n_drive, n_elec, n_pairs) in V/ohm."""
        return by_pairs(self.potential_weights, self.currents[:, None])


def by_pairs(c: Floats, d: Floats) -> Floats:
    """The rows (..., n_pairs) that make c . dS d of dR_ij, for zero-sum c and d (..., n_elec)."""
    i, j = all_pairs(c.shape[-1]).T
    return np.asarray(-(c[..., i] * d[..., j] + c[..., j] * d[..., i]) / 2)


def drive_currents(model: TransferModel, currents: ArrayLike) -> Response:
    """The response to given currents into all electrodes, such as trigonometric patterns.

    Args:
        model: The skin.
        currents: (n_drive, n_elec) in amperes, each row summing to zero.

    Raises:
        ModelError: If the currents do not fit the electrodes, are not finite, or a row does not sum to zero.
    """
    given, n_elec = real(currents, "currents are", ModelError), len(model.electrodes)
    if given.ndim != 2 or given.shape[1] != n_elec:
        raise ModelError(f"currents have shape {given.shape}; give (n_drive, {n_elec}), one for each electrode")
    if not np.isfinite(given).all():
        k = int(np.argmin(np.isfinite(given).all(axis=1)))
        raise ModelError(f"currents of excitation {k} are not finite; give 0 for no current")
    excess = np.abs(given.sum(axis=1)) - 1e-9 * np.abs(given).sum(axis=1)
    if (excess > 0).any():
        k = int(np.argmax(excess))
        raise ModelError(f"currents of excitation {k} sum to {given[k].sum():.3g} A; make it 0")
    centred = np.eye(n_elec) - 1 / n_elec
    weights = np.broadcast_to(centred, (len(given), n_elec, n_elec))
    return Response(given, given @ model.transfer_resistance, np.zeros_like(weights), weights)


def drive_voltages(
    model: TransferModel, voltages: ArrayLike, resistance: ArrayLike = 0.0, dirichlet_points: bool = False
) -> Response:
    """The response to given voltages at some electrodes; the others carry no current (Dirichlet through the contacts).

    Args:
        model: The skin, with area electrodes where it is driven.
        voltages: (n_drive, n_elec) in volts, NaN at electrodes that are not driven.
        resistance: In series between the source and each driven electrode, one value or (n_elec,) in ohms.
        dirichlet_points: Whether points may be driven, too. The potential of a point's node is then given, which is an
            idealisation: its current depends on the mesh, and falls towards zero as that is refined.

    Raises:
        ModelError: If shapes or values do not fit, fewer than two electrodes are driven, or one is a point.
    """
    given, n_elec = real(voltages, "voltages are", ModelError), len(model.electrodes)
    if given.ndim != 2 or given.shape[1] != n_elec:
        raise ModelError(f"voltages have shape {given.shape}; give (n_drive, {n_elec}), NaN where not driven")
    if np.isinf(given).any():
        raise ModelError("a voltage is infinite; give NaN where an electrode is not driven")
    fits = np.size(resistance) in (1, n_elec)
    series = np.array(np.broadcast_to(np.asarray(resistance, float), n_elec)) if fits else np.full(n_elec, np.nan)
    if not (np.isfinite(series) & (series >= 0)).all():
        allowed = f"give one value or ({n_elec},), finite and not negative (ohm)"
        raise ModelError(f"series resistance is {np.asarray(resistance)}; {allowed}")
    s = model.transfer_resistance
    currents, potentials = np.zeros_like(given), np.empty_like(given)
    by_current, by_potential = np.zeros((len(given), n_elec, n_elec)), np.zeros((len(given), n_elec, n_elec))
    for k, row in enumerate(given):
        driven = np.flatnonzero(np.isfinite(row))
        if len(driven) < 2:
            raise ModelError(f"excitation {k} gives {len(driven)} electrodes a voltage; give two or more")
        if not dirichlet_points:
            _refuse_points(model, driven, "; or idealise it: dirichlet_points=True")
        count = len(driven)
        bordered = np.ones((count + 1, count + 1))
        bordered[:count, :count] = s[np.ix_(driven, driven)] + np.diag(series[driven])
        bordered[count, count] = 0
        inverse = np.linalg.inv(bordered)
        solution = inverse @ np.append(row[driven], 0.0)
        currents[k, driven] = solution[:count]
        potentials[k] = s[:, driven] @ solution[:count] + solution[count]
        by_current[k][np.ix_(driven, driven)] = -inverse[:count, :count]
        by_potential[k] = np.eye(n_elec)
        by_potential[k][:, driven] -= s[:, driven] @ inverse[:count, :count] + inverse[count, :count]
    return Response(currents, potentials, by_current, by_potential)


@dataclass(frozen=True)
class VoltageSource:
    """A voltage source that drives one pair of electrodes after the other through resistance in its path (the paper's).

    The current of a pair is amplitude / (R_pair + resistance), so a touch changes it, too.

    Args:
        amplitude: Voltage of the source (V).
        resistance: All that is in series: source, both multiplexers, shunt (ohm).

    Raises:
        ModelError: If the amplitude is zero or not finite, or the resistance negative or not finite.
    """

    amplitude: float
    resistance: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.amplitude) or self.amplitude == 0:
            raise ModelError(f"source amplitude is {self.amplitude} V; it must be finite and not zero")
        if not (np.isfinite(self.resistance) and self.resistance >= 0):
            raise ModelError(f"source resistance is {self.resistance} ohm; it must be finite and not negative")

    def currents(self, model: TransferModel, pattern: DrivePattern) -> Floats:
        """The current (n_inj,) of each injection of a pattern (A).

        Args:
            model: The sheet, its electrodes with contact impedances.
            pattern: The injections.

        Raises:
            ModelError: If a driven electrode is a point, whose own resistance is that of the mesh.
            PatternError: If the pattern names an electrode that is not there.
        """
        pattern.check(len(model.electrodes))
        return self._through(model, pattern.injections)

    def pair_currents(self, model: TransferModel) -> Floats:
        """The current (n_pairs,) through each of the model's pairs of electrodes (A); raises as `currents`."""
        return self._through(model, model.pairs.ends)

    def _through(self, model: TransferModel, ends: Ints) -> Floats:
        _refuse_points(model, np.unique(ends))
        (source, sink), s = ends.T, model.transfer_resistance
        pair = s[source, source] + s[sink, sink] - 2 * s[source, sink]
        return np.asarray(self.amplitude / (pair + self.resistance))

    def voltages(self, model: TransferModel, pattern: DrivePattern) -> Floats:
        """Voltages (n_meas,) of a pattern (V); arguments and errors as for `currents`."""
        return model.voltages(pattern, self.currents(model, pattern))

    def by_pairs(self, model: TransferModel, pattern: DrivePattern) -> Floats:
        """d voltages / d R_ij (n_meas, n_pairs) in V/ohm, including the change of the current.

        J_V = I (J_m - R_m / (R_pair + resistance) J_pair). Times `TransferModel.pair_sensitivity` it is dV/dsigma.
        Arguments and errors as for `currents`.
        """
        nothing = np.zeros(pattern.n_meas)
        known = self.unmeasured(model, Difference(pattern, nothing, nothing))
        return np.asarray(known.combination(model.pairs).toarray() * known.currents[:, None])

    def unmeasured(self, model: TransferModel, difference: Difference) -> Difference:
        """A difference whose currents were not measured but taken from `currents`, with the effect of source loading.

        The baseline must have been learned with the same currents in its frames. A contact lowers the resistance of
        the driven pair too and raises its current: to first order dV = I (dR_m - R_m / (R_pair + resistance) dR_pair).

        Args:
            model: As for `currents`.
            difference: Change of the voltages (V).
        """
        amperes = self.currents(model, difference.pattern)[difference.pattern.measurements[:, 0]]
        loading = model.voltages(difference.pattern) * amperes / self.amplitude
        return replace(difference, currents=amperes, source_loading=loading)

    def sensitivity(self, model: TransferModel, pattern: DrivePattern) -> Floats:
        """dV/dsigma (n_meas, n_elem) of a pattern (V/S), including the change of the current.

        Arguments and errors as for `currents`.
        """
        return np.asarray(self.by_pairs(model, pattern) @ model.pair_sensitivity)

    def contact_sensitivity(self, model: TransferModel, pattern: DrivePattern) -> Floats:
        """dV/dz (n_meas, n_elec) of a pattern in V per ohm m2 (disc) or ohm m (rim), the current's change included.

        Arguments and errors as for `currents`.
        """
        return np.asarray(self.by_pairs(model, pattern) @ model.pair_contact_sensitivity)


def _refuse_points(model: TransferModel, driven: np.ndarray, otherwise: str = "") -> None:
    if len(points := driven[~model.electrodes.are_areas[driven]]):
        advice = "give it an area (Electrodes.with_discs, with_rim_segments) to drive it by a voltage"
        grows = "whose own resistance grows without bound as the mesh is refined"
        raise ModelError(f"electrode {points[0]} is a point, {grows}; {advice}{otherwise}")
