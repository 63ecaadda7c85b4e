"""Self-calibration: positions of the electrodes and conductivity of the sheet, from one complete scan in volts.

Screws go in a millimetre or two off, and a sprayed sheet is uneven by some per cent; both cost more accuracy than noise
does. The four-terminal resistances of all injections, in which contact resistances do not count, determine both:
Gauss-Newton from the description, with priors of what may well be, on the estimator's own mesh, so that what that gets
wrong of the untouched sheet is made good, too.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import DataError, ModelError, OhmskinError
from ohmskin.forward import TransferModel
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import Domain, Electrodes
from ohmskin.geometry.periodic import folded, shortest
from ohmskin.scan import DrivePattern

WAVES = 6  # half waves of the logarithm of the conductivity along each side, 0 to 5
_PLACE = 0.01  # standard deviation of an electrode's place, as a share of the sheet's shorter side: 2 mm of 20 cm
_UNEVEN = 0.05  # of the conductivity
_LEVEL = 1.0  # of the logarithm of its mean
_ERROR = 2e-3  # error of the model, as a share of a resistance
_FLOOR = 0.3  # the same of one that is nearly zero, as a share of that of a typical one
_CORNER = 4e-3  # share of the shorter side within which an electrode is at a corner, where a mesh has a node
_ROUNDS = 8
_CONVERGED = 1e-2  # share of the cost by which a round must lower it
_EXPLAINED = 2.0  # root mean square of what is left, in standard deviations, above which the sheet is not like this
_KNOWN = 1.1  # times the noise that is estimated of few scans, it may be
_FARTHEST = 4.0  # standard deviations by which an electrode may be off

Build = Callable[[Electrodes, Floats], TransferModel]


@dataclass(frozen=True, eq=False)
class SheetFit:
    """A model fitted to the untouched skin.

    Args:
        model: With fitted electrode positions and sheet conductivity.
        log_conductivity: (`WAVES`^2,) coefficients of `cosines`: logarithm of its factor on the described conductivity.
        moved: (n_elec,) distances of electrodes from their described places (m).
        uneven: Standard deviation of the conductivity over the sheet, as a share of its mean.
        before: Root mean square residual of four-terminal resistances for the described skin, at the best mean
            conductivity, as a share of their root mean square.
        after: The same of the fit.
        noise: What of that noise alone would leave.
    """

    model: TransferModel
    log_conductivity: Floats = field(repr=False)
    moved: Floats = field(repr=False)
    uneven: float
    before: float
    after: float
    noise: float

    @property
    def left(self) -> float:
        """Root mean square residual of the fit that is surely no noise, as a share (1)."""
        return float(np.sqrt(max(self.after**2 - (_KNOWN * self.noise) ** 2, 0.0)))


def fit_sheet(
    domain: Domain,
    described: Electrodes,
    build: Build,
    pattern: DrivePattern,
    resistances: Floats,
    noise: Floats | float,
) -> SheetFit:
    """Fit places of electrodes, along the rim for those on it, and conductivity to the untouched skin.

    Args:
        domain: The sheet, flat.
        described: The electrodes as described.
        build: Makes a model of the sheet, given electrodes and the coefficients (`WAVES`^2,) of the logarithm of a
            factor on its conductivity, see `cosines`.
        pattern: What was driven, without driven electrodes.
        resistances: (n_meas,) measured transfer resistances (ohm); what is not finite is left out.
        noise: Their standard deviation, one or (n_meas,) (ohm).

    Raises:
        DataError: If no such sheet explains the data; the message gives the residual.
    """
    known = np.isfinite(resistances)
    measured, rows = resistances[known], pattern.combination(len(described))[known]
    unknowns = _Unknowns(domain, described)
    typical = float(np.sqrt(np.mean(measured**2)))
    error = _ERROR * np.maximum(np.abs(measured), _FLOOR * typical)
    scatter = np.broadcast_to(noise, known.shape)[known]
    std = np.hypot(error, scatter)

    def at(u: Floats) -> tuple[TransferModel, Floats, float]:
        model = build(unknowns.electrodes(u), unknowns.log_conductivity(u))
        left = (measured - rows @ model.pair_resistances) / std
        return model, left, float(left @ left + np.sum((u / unknowns.std) ** 2))

    u = unknowns.scaled(build(described, np.zeros(WAVES**2)), rows, measured)
    model, left, cost = at(u)
    before = float(np.sqrt(np.mean((left * std) ** 2))) / typical
    for _ in range(_ROUNDS):
        slopes = (rows @ unknowns.slopes(u, model)) / std[:, None]
        normal = slopes.T @ slopes + np.diag(unknowns.std**-2.0)
        step = np.linalg.solve(normal, slopes.T @ left - u / unknowns.std**2)
        last = cost
        step /= max(1.0, float(np.abs(step / unknowns.std).max()) / _FARTHEST)
        while True:  # half the way and less, until the cost falls
            try:
                other, its_left, its_cost = at(u + step)
            except OhmskinError:  # two electrodes at one place, or one off the sheet
                other, its_left, its_cost = model, left, np.inf
            if its_cost < cost or np.abs(step / unknowns.std).max() < 1e-2:
                break
            step /= 2
        if its_cost < cost:
            u, model, left, cost = u + step, other, its_left, its_cost
        if last - cost < _CONVERGED * last:
            break
    after = float(np.sqrt(np.mean((left * std) ** 2))) / typical
    moved = np.linalg.norm(shortest(model.electrodes.positions - described.positions, domain.period), axis=1)
    farthest, most = int(np.argmax(moved)), _FARTHEST * float(unknowns.std[0])
    if not np.sqrt(np.mean(left**2)) < _EXPLAINED or moved[farthest] > most:
        raise DataError(
            f"the quiet skin is not the one described: {100 * before:.2g} % of its resistances are unlike the "
            f"description's, and {100 * after:.2g} % are with electrodes moved by up to {1e3 * moved[farthest]:.2g} mm "
            f"(electrode {farthest}; at most {1e3 * most:.2g} mm) and an uneven sheet; check size, places and order of "
            "the electrodes, and that nothing touches the skin"
        )
    factor = np.exp(cosines(model.mesh.centroids, domain, unknowns.log_conductivity(u)))
    mean = np.average(factor, weights=model.mesh.measures)
    uneven = float(np.sqrt(np.average((factor / mean - 1) ** 2, weights=model.mesh.measures)))
    noise_share = float(np.sqrt(np.mean(scatter**2))) / typical
    return SheetFit(model, unknowns.log_conductivity(u), moved, uneven, before, after, noise_share)


class _Unknowns:
    """What is fitted: for each electrode a way along the rim or along x, for each a way along y, and the waves."""

    def __init__(self, domain: Domain, described: Electrodes) -> None:
        if described.positions.shape[1] != 2:
            raise ModelError("positions of electrodes are fitted on flat sheets and maps only")
        self.domain, self.described, n_elec = domain, described, len(described)
        x0, y0, x1, y1 = domain.bounds
        shorter = min(x1 - x0, y1 - y0)
        self.on_rim = domain.depth(described.positions) < 1e-6 * shorter
        loops = np.array([domain, *domain.holes], object)
        away = [loop.rim(loop.arc(described.positions)) - described.positions for loop in loops]
        self._loops = loops[np.linalg.norm(shortest(np.array(away), domain.period), axis=2).argmin(axis=0)]
        self.arcs = np.array([float(loop.arc(at[None])[0]) for loop, at in self._each(described.positions)])
        self._at_corner = _CORNER * shorter
        waves = np.full(WAVES**2, _UNEVEN / np.sqrt((WAVES**2 - 1) / 4))
        waves[0] = _LEVEL
        places = np.full(2 * n_elec, _PLACE * shorter)
        places[n_elec:][self.on_rim] = 1e-9
        self.std = np.concatenate([places, waves])

    def electrodes(self, u: Floats) -> Electrodes:
        """Where the electrodes are."""
        n_elec = len(self.described)
        places = self.described.positions + np.column_stack([u[:n_elec], u[n_elec : 2 * n_elec]])
        if self.on_rim.any():
            arcs = self.arcs + u[:n_elec]
            for corner in np.asarray(self.domain.corners):
                half = self.domain.perimeter / 2
                beside = np.abs((arcs - corner + half) % (2 * half) - half) < self._at_corner
                arcs = np.where(beside & (self._loops == self.domain), corner, arcs)
            places[self.on_rim] = self._rim(arcs)[self.on_rim]
        return self.described.mapped(lambda _: folded(places, self.domain.period))

    def _each(self, values: Floats) -> Iterator[tuple[Domain, Floats]]:
        """The rim closest to each electrode, with its value."""
        return zip(self._loops, values, strict=True)

    def _rim(self, arcs: Floats) -> Floats:
        """Places (n_elec, 2) at arc lengths (n_elec,) of each electrode's rim (m)."""
        return np.vstack([loop.rim(arc) for loop, arc in self._each(arcs[:, None])])

    def log_conductivity(self, u: Floats) -> Floats:
        """Coefficients of `cosines`."""
        return u[2 * len(self.described) :]

    def scaled(self, model: TransferModel, rows: Floats, measured: Floats) -> Floats:
        """The description, its mean conductivity as measured."""
        modelled = rows @ model.pair_resistances
        u = np.zeros(len(self.std))
        scale = float(modelled @ modelled) / float(modelled @ measured)
        if not scale > 0:
            raise DataError("the quiet skin's resistances have the wrong sign: are sources and sinks swapped?")
        u[2 * len(self.described)] = np.log(scale)
        return u

    def slopes(self, u: Floats, model: TransferModel) -> Floats:
        """(n_pairs, n_unknowns) of the two-terminal resistances, up to what contact resistances do to them."""
        n_elec = len(self.described)
        along = np.tile(np.eye(2), (n_elec, 1, 1))  # (n_elec, 2 ways, 2)
        arcs, step = self.arcs + u[:n_elec], 1e-6 * self.domain.perimeter
        tangent = shortest(self._rim(arcs + step) - self._rim(arcs), self.domain.period) / step
        along[self.on_rim, 0] = tangent[self.on_rim]
        ways = np.einsum("kwd,pkd->pwk", along, model.pair_movement(slide=True)).reshape(-1, 2 * n_elec)
        waves = cosines(model.mesh.centroids, self.domain, np.eye(WAVES**2))
        return np.hstack([ways, model.pair_sensitivity @ (model.conductivity[:, None] * waves)])
