"""Discs fitted to data for the test of one against two, independently of the estimators that are compared.

Contacts act as in `ContactTable`. Each has four parameters: x, y, the logarithm of its effect, the logarithm of its radius; of the
radius it may be known that it is about `RADIUS`. Levenberg-Marquardt.
"""

from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.policies.lab import RADIUS
from ohmskin.evaluate.worlds import CURRENT
from ohmskin.forward import ContactTable
from ohmskin.geometry.domain import Floats
from ohmskin.scan import Difference

RADIUS_FACTOR = 1.5  # by which a radius may well differ from the usual one
_PER_DISC = 4
_SPACING = 7.5e-3  # metres between the places at which a first disc is sought
_APART = 8e-3  # metres from a disc to either of the two that are sought in its place
_FARTHEST = 5e-3  # metres that a disc may move in one step
_NARROW, _WIDE = 0.35, 1.9  # shares of the usual radius; the table ends there


@dataclass(frozen=True, eq=False)
class Discs:
    """Discs that fit best.

    Args:
        params: (n, 4) x, y (m), log effect (m2), log radius (m).
        left: (n_data,) what they leave of the data, in noise units.
        cost: Sum of its squares, and of what is known beforehand.
    """

    params: Floats
    left: Floats
    cost: float

    @property
    def positions(self) -> Floats:
        """(n, 2) in metres."""
        return self.params[:, :2]


class Likeness:
    """Data as a number of discs would have them.

    Args:
        table: Responses of contacts.
        rows: (n_data, n_pairs) what two-terminal resistances do to the data, in noise units per ohm.
        data: (n_data,) in noise units.
        informed: Whether the radius is known as above.
    """

    def __init__(self, table: ContactTable, rows: Floats, data: Floats, informed: bool = True) -> None:
        if len(rows) > rows.shape[1]:  # what no pair resistance can explain says nothing about discs
            basis, rows = np.linalg.qr(rows)
            data = basis.T @ data
        self._table, self._rows, self._data = table, rows, data
        low, high = table.places.min(axis=0), table.places.max(axis=0)
        self._low = np.array([*low, -50.0, np.log(_NARROW * table.radius)])
        self._high = np.array([*high, 50.0, np.log(_WIDE * table.radius)])
        self._certainty = 1 / np.log(RADIUS_FACTOR) if informed else 0.0

    @classmethod
    def of(cls, table: ContactTable, noise: float, differences: tuple[Difference, ...]) -> "Likeness":
        """The likeness of scans at `CURRENT` with a noise (V)."""
        rows = np.vstack([d.pattern.combination(table.n_elec).toarray() for d in differences]) * CURRENT / noise
        return cls(table, rows, np.concatenate([d.volts for d in differences]) / noise)

    def one(self) -> Discs:
        """The best single disc."""
        lattice = np.round(self._table.places / _SPACING, 3)
        some = np.flatnonzero((np.abs(lattice - np.round(lattice)) < 0.17).all(axis=1))
        columns = self._rows @ self._table.responses[some].T
        score, power = self._data @ columns, np.einsum("dp,dp->p", columns, columns)
        best = int(np.argmax(np.where(score > 0, score**2 / power, 0.0)))
        effect = max(score[best] / power[best], 1e-9)
        return self.refine(np.array([[*self._table.places[some[best]], np.log(effect), np.log(RADIUS)]]))

    def two(self, one: Discs) -> Discs:
        """The best two discs that are found where the single one is, apart along one of four directions."""
        found = []
        for angle in np.arange(4) * np.pi / 4:
            pair = np.tile(one.params, (2, 1))
            pair[:, :2] += np.outer([_APART, -_APART], [np.cos(angle), np.sin(angle)])
            pair[:, 2] -= np.log(2)
            found.append(self.refine(pair, rounds=6))
        return self.refine(min(found, key=lambda discs: discs.cost).params)

    def refine(self, start: Floats, rounds: int = 30) -> Discs:
        """The discs near `start` (n, 4) that fit best."""
        params, damping = self._within(start), 1e-3
        residual, slopes = self._linearise(params)
        cost = float(residual @ residual)
        for _ in range(rounds):
            normal, gradient = slopes.T @ slopes, slopes.T @ residual
            step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), gradient).reshape(params.shape)
            limits = np.array([_FARTHEST, _FARTHEST, 0.7, 0.5])
            moved = self._within(params + np.clip(step, -limits, limits))
            trial, trial_slopes = self._linearise(moved)
            gain = cost - float(trial @ trial)
            if gain > 0:
                params, residual, slopes, cost, damping = moved, trial, trial_slopes, cost - gain, damping / 5
                if gain < 1e-3:
                    break
            else:
                damping *= 6
                if damping > 1e4:
                    break
        return Discs(params, residual[: len(self._data)], cost)

    def _within(self, params: Floats) -> Floats:
        return np.clip(params, self._low, self._high)

    def _linearise(self, params: Floats) -> tuple[Floats, Floats]:
        """What is left (n_data + n,), and how it falls with the parameters (n_data + n, 4 n)."""
        radius, effect = np.exp(params[:, 3]), np.exp(params[:, 2])[:, None, None]
        found = self._table(params[:, :2], radius)
        widening = 2 * (radius**2)[:, None] * found.widening
        parts = effect * np.stack([found.slopes[:, 0], found.slopes[:, 1], found.values, widening], axis=1)
        slopes = self._rows @ parts.reshape(-1, parts.shape[-1]).T
        left = self._data - slopes[:, 2::_PER_DISC].sum(axis=1)
        known = np.zeros((len(params), slopes.shape[1]))
        known[np.arange(len(params)), np.arange(3, slopes.shape[1], _PER_DISC)] = self._certainty
        off = self._certainty * (np.log(RADIUS) - params[:, 3])
        return np.concatenate([left, off]), np.vstack([slopes, known])
