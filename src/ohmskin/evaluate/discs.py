"""One contact or two? Discs fitted to the data themselves, and a test between them.

The model is linear in conductivity: a contact at p changes the two-terminal resistances of all electrode pairs by a D(p),
with D the response of a disc of known radius, kept as cubic splines over the sheet, and a its strength. A scan measures A D
(`DrivePattern.combination`); noise is white and its standard deviation known, so that residuals have a chi-square.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import spline_filter1d

from ohmskin.forward import TransferModel
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.scan import Difference

_PITCH = 2.5e-3  # metres between places at which responses are kept
_WINDOW = 45e-3  # metres about the best single disc in which two are sought
_COARSE = 2  # every second place in that search


@dataclass(frozen=True)
class Fit:
    """Discs that fit the data best.

    Args:
        positions: (n_discs, 2) in metres.
        strengths: (n_discs,) relative conductivity change (1).
        chi_square: Squared residuals over the noise's variance.
    """

    positions: Floats
    strengths: Floats
    chi_square: float


class DiscModel:
    """Responses of discs of one radius anywhere on a flat, rectangular sheet.

    Args:
        model: Forward model of the untouched sheet.
        radius: Radius of the discs (m).
    """

    def __init__(self, model: TransferModel, radius: float) -> None:
        mesh = model.mesh
        self._low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        self._shape = tuple(np.round((high - self._low) / _PITCH).astype(int) + 1)
        x, y = (self._low[k] + _PITCH * np.arange(self._shape[k]) for k in range(2))
        self.places: Floats = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        share = disc_overlap(mesh, self.places, radius) @ sp.diags_array(1 / mesh.measures)
        self.responses: Floats = share @ (model.pair_sensitivity * model.conductivity).T  # (n_places, n_pairs) ohms
        knots = self.responses.reshape(*self._shape, -1)
        for axis in (0, 1):
            knots = spline_filter1d(knots, order=3, axis=axis, mode="mirror")
        self._knots = np.pad(knots, ((1, 2), (1, 2), (0, 0)), mode="reflect")
        self.n_elec = len(model.electrodes)

    def response(self, position: Floats) -> tuple[Floats, Floats]:
        """D (n_pairs,) at a position in metres, ohms, and its gradient (2, n_pairs) in ohms per metre; clamped to the sheet."""
        at = np.clip((position - self._low) / _PITCH, 0, np.array(self._shape) - 1.0)
        first = np.minimum(at.astype(int), np.array(self._shape) - 2)
        (bx, dx), (by, dy) = (_cubic(float(t)) for t in at - first)
        patch = self._knots[first[0] : first[0] + 4, first[1] : first[1] + 4]
        value = np.einsum("i,j,ijp->p", bx, by, patch)
        slope = np.stack([np.einsum("i,j,ijp->p", dx, by, patch), np.einsum("i,j,ijp->p", bx, dy, patch)]) / _PITCH
        return value, slope


def _cubic(t: float) -> tuple[Floats, Floats]:
    """The four cubic B-splines that reach a point t (0 to 1) between two knots, and their derivatives."""
    b = np.array([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6
    d = np.array([-((1 - t) ** 2), 3 * t**2 - 4 * t, -3 * t**2 + 2 * t + 1, t**2]) / 2
    return b, d


@dataclass
class DiscTest:
    """Fits one disc and two discs to the same data.

    Args:
        model: The responses.
        noise: Standard deviation of a voltage (V).
        differences: The scans.
    """

    model: DiscModel
    noise: float
    differences: tuple[Difference, ...]
    _rows: Floats = field(init=False, repr=False)
    _data: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows = np.vstack(
            [d.pattern.combination(self.model.n_elec).toarray() * (d.currents / self.noise)[:, None] for d in self.differences]
        )
        volts = np.concatenate([d.volts for d in self.differences]) / self.noise
        self._rest = 0.0
        if len(rows) > rows.shape[1]:
            basis, triangle = np.linalg.qr(rows)
            data = basis.T @ volts
            self._rest = float(volts @ volts - data @ data)  # beyond the reach of any conductivity
            rows, volts = triangle, data
        self._rows, self._data = rows, volts
        self._columns = self._rows @ self.model.responses.T  # (n_rows, n_places)

    def one(self) -> Fit:
        """The best single disc."""
        score = self._columns.T @ self._data
        power = np.einsum("rp,rp->p", self._columns, self._columns)
        best = int(np.argmax(np.where(score > 0, score**2 / power, 0.0)))
        return self._refine(self.model.places[[best]], np.array([score[best] / power[best]]))

    def two(self, one: Fit) -> Fit:
        """The best two discs of positive strength, given the best single one: the better of two starts.

        The first is the best pair within `_WINDOW` of the single disc, which finds two that it lies between; the second
        keeps it and adds the best place for what it leaves, wherever that is.
        """
        return min(self._refine(*self._pair_about(one.positions[0])), self._refine(*self._added(one)), key=lambda f: f.chi_square)

    def _pair_about(self, middle: Floats) -> tuple[Floats, Floats]:
        places = self.model.places
        lattice = np.round((places - places[0]) / _PITCH).astype(int) % _COARSE == 0
        near = np.flatnonzero((np.abs(places - middle) < _WINDOW).all(axis=1) & lattice.all(axis=1))
        columns = self._columns[:, near]
        gram, score = columns.T @ columns, columns.T @ self._data
        i, j = np.triu_indices(len(near), k=1)
        det = gram[i, i] * gram[j, j] - gram[i, j] ** 2
        det = np.maximum(det, 1e-12 * gram[i, i] * gram[j, j])
        a = (gram[j, j] * score[i] - gram[i, j] * score[j]) / det
        b = (gram[i, i] * score[j] - gram[i, j] * score[i]) / det
        best = int(np.argmax(np.where((a > 0) & (b > 0), a * score[i] + b * score[j], -np.inf)))
        return places[near[[i[best], j[best]]]], np.array([a[best], b[best]])

    def _added(self, one: Fit) -> tuple[Floats, Floats]:
        left, _ = self._linearise(one.positions, one.strengths)
        score, power = self._columns.T @ left, np.einsum("rp,rp->p", self._columns, self._columns)
        best = int(np.argmax(np.where(score > 0, score**2 / power, 0.0)))
        return np.vstack([one.positions, self.model.places[best]]), np.append(one.strengths, score[best] / power[best])

    def _refine(self, positions: Floats, strengths: Floats, rounds: int = 25) -> Fit:
        """Levenberg-Marquardt from a start; positions stay on the sheet, strengths stay positive."""
        damping = 1e-3
        residual, slopes = self._linearise(positions, strengths)
        for _ in range(rounds):
            normal, gradient = slopes.T @ slopes, slopes.T @ residual
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            moved = positions + np.clip(step[: positions.size].reshape(-1, 2), -_PITCH * 2, _PITCH * 2)
            changed = np.maximum(strengths + step[positions.size :], 1e-6)
            trial, trial_slopes = self._linearise(moved, changed)
            gain = residual @ residual - trial @ trial
            if gain > 0:
                positions, strengths, residual, slopes, damping = moved, changed, trial, trial_slopes, damping / 5
                if gain < 1e-3:
                    break
            else:
                damping *= 10
                if damping > 1e6:
                    break
        return Fit(positions, strengths, float(residual @ residual) + self._rest)

    def _linearise(self, positions: Floats, strengths: Floats) -> tuple[Floats, Floats]:
        """What is left of the data (n_rows,), and the slopes (n_rows, 3 n_discs) for positions and then strengths."""
        parts = [self.model.response(position) for position in positions]
        values = self._rows @ np.stack([value for value, _ in parts], axis=1)
        moves = [self._rows @ (slope * a).T for (_, slope), a in zip(parts, strengths, strict=True)]
        return self._data - values @ strengths, np.hstack([*moves, values])
