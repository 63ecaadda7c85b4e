"""The wiring that explains the two-terminal resistances of a sheet best: wires exchanged or bridged, poor contacts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ohmskin.arrays import Floats
from ohmskin.forward import TransferModel
from ohmskin.scan import all_pairs, pair_index, two_terminal
from ohmskin.scan.pairs import in_series
from ohmskin.skin import Skin

MOST_FAULTS = 6
_SEARCH = 3e-3  # relative misfit below which the wiring is as the model says; mesh and noise leave 1e-3
EXPLAINS = 0.7  # share of the squared misfit that an exchange must not leave
_EXPLAINS_LITTLE = 0.9  # the same of a bridge, which is seen in its own pair first
_BRIDGED = 0.6  # share of its modelled resistance below which a pair may be bridged
_SURELY = 0.12  # the same, below which it is; an exchange of wires does not get there
_OHMS = 1e-2  # the least that a bridge may have (ohm)
_MOST_OHMS = 4.0  # the most, as a share of the resistance measured across it
_CANDIDATES = 4  # looked at closely
_LEAK = 1.5  # resistance of a bridge, as a share of the pair's, above which it is none
_MESH = 0.55  # the estimator's edge length times this resolves the electrodes


@dataclass(frozen=True)
class WiringHypothesis:
    """A way that the electrodes may be wired.

    Args:
        order: The electrode that each terminal goes to.
        bridges: Pairs of terminals that are bridged.
        ohms: What each bridge has, or about so (ohm).
    """

    order: tuple[int, ...]
    bridges: tuple[tuple[int, int], ...] = ()
    ohms: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class WiringFit:
    """A hypothesis fitted to the measured resistances.

    Args:
        wiring: The hypothesis, its bridges with the resistances fitted.
        scale: Factor on the modelled resistances.
        series: (n,) series resistance at each terminal (ohm).
        around: (n,) modelled resistance from it to all others (ohm).
        predicted: (n_pairs,) resistances (ohm).
        unbridged: (n_pairs,) the same without the bridges.
        squares: Sum of the squared relative misfits.
        misfit: Root mean square of them, by degree of freedom.
    """

    wiring: WiringHypothesis
    scale: float
    series: Floats
    around: Floats
    predicted: Floats
    unbridged: Floats
    squares: float
    misfit: float

    @property
    def bridges(self) -> Iterator[tuple[tuple[int, int], float, float]]:
        """Each bridge: its terminals, its resistance, and that of the sheet between them (ohm)."""
        for (a, b), ohms in zip(self.wiring.bridges, self.wiring.ohms, strict=True):
            yield (a, b), ohms, float(self.unbridged[pair_index(a, b, len(self.series))])


class WiringSearch:
    """Searches the wiring that explains measured pair resistances, which a slowly varying conductivity may change.

    Args:
        skin: What the sheet should be.
        alive: (n,) electrodes that are of use.
        measured: (n_pairs,) resistances of the pairs of these (ohm).
    """

    def __init__(self, skin: Skin, alive: NDArray[np.int64], measured: Floats) -> None:
        self.n, self.measured = len(alive), measured
        self.pairs = all_pairs(self.n)
        around, columns = _sheet(skin)
        columns = columns[np.isin(all_pairs(len(skin.electrodes)), alive).all(axis=1)]
        if len(self.pairs) < 3 * (self.n + 6):  # else the slow changes would explain everything
            columns = columns[:, :1]
        self._weight = 1 / columns[:, 0]
        self._around, self._columns, self._ends = around[alive], columns, in_series(range(self.n), self.n)
        ratios = measured / columns[:, 0]
        self._ratios: Floats = ratios / float(np.median(ratios))

    def best(self) -> WiringFit:
        """The wiring that explains the measured resistances best without inventing faults."""
        best = self._fit(self._with_shorts())
        if len(self.pairs) < self._columns.shape[1] + 2 * self.n:
            return best  # too few electrodes to distinguish faults
        for _ in range(MOST_FAULTS):
            if best.misfit <= _SEARCH:
                break
            tried = [self._fit(other) for other in [*self._bridged_more(best.wiring), *self._exchanged(best)]]
            worth = []
            for other in tried:
                share = EXPLAINS if other.wiring.bridges == best.wiring.bridges else _EXPLAINS_LITTLE
                leaks = all(ohms < _LEAK * own for _, ohms, own in other.bridges)  # a good part of the pair's current
                if other.squares < share * best.squares and leaks:
                    worth.append(other)
            if not worth:
                break
            best = min(worth, key=lambda fit: fit.squares)
        return best

    def _with_shorts(self) -> WiringHypothesis:
        """Straight wires, and a bridge where two electrodes are so close that no exchange of wires explains it."""
        bridges: list[tuple[int, int]] = []
        joined = np.arange(self.n)
        for k in np.argsort(self._ratios).tolist():
            a, b = self.pairs[k].tolist()
            if self._ratios[k] < _SURELY and joined[a] != joined[b]:  # of three shorted, two bridges say it all
                joined[joined == joined[b]] = joined[a]
                bridges.append((a, b))
        return WiringHypothesis(tuple(range(self.n)), tuple(bridges), tuple(self._across(bridges).tolist()))

    def _bridged_more(self, wiring: WiringHypothesis) -> Iterator[WiringHypothesis]:
        """The same wiring with one bridge more, the likeliest."""
        free = np.flatnonzero(self._not_bridged(wiring) & (self._ratios < _BRIDGED))
        for k in free[np.argsort(self._ratios[free])][:_CANDIDATES]:
            a, b = self.pairs[k].tolist()
            yield replace(wiring, bridges=(*wiring.bridges, (a, b)), ohms=(*wiring.ohms, float(self.measured[k])))

    def _exchanged(self, fit: WiringFit) -> list[WiringHypothesis]:
        """The same wiring with two wires exchanged, the likeliest if what the bridges do stays as it is."""
        corrected = self.measured - (fit.predicted - fit.unbridged)
        kept = self._not_bridged(fit.wiring)
        found = []
        for a, b in self.pairs[kept].tolist():
            order = list(fit.wiring.order)
            order[a], order[b] = order[b], order[a]
            design = self._design(order)
            left = (design @ self._solved(design, corrected, kept) - corrected)[kept] * self._weight[kept]
            found.append((float(left @ left), replace(fit.wiring, order=tuple(order))))
        return [other for _, other in sorted(found, key=lambda pair: pair[0])[:_CANDIDATES]]

    def _fit(self, wiring: WiringHypothesis) -> WiringFit:
        """Scale, slow changes, series resistances and bridges that fit best, relative to the modelled resistances."""
        design, every = self._design(wiring.order), np.ones(len(self.pairs), bool)
        n_params, n_sheet = design.shape[1], self._columns.shape[1]
        ohms: Floats = np.array(wiring.ohms)
        if not wiring.bridges:
            free = self._solved(design, self.measured, every)
        else:
            across = self._across(wiring.bridges)  # as the pair is in parallel to its bridge
            bounds = np.log(_OHMS), np.log(_MOST_OHMS * np.maximum(across, _OHMS))

            def residual(values: Floats) -> Floats:
                bridges = np.exp(np.clip(values[n_params:], *bounds))
                predicted = _bridged(design @ values[:n_params], wiring.bridges, bridges)
                return np.asarray((predicted - self.measured) * self._weight)

            undisturbed = self._solved(design, self.measured, self._not_bridged(wiring))
            start = np.concatenate([undisturbed, np.clip(np.log(np.maximum(ohms, _OHMS)), *bounds)])
            # scaled by what they do: a conductivity, and ohms
            scales = np.concatenate([np.ones(n_sheet), np.full(self.n, 100.0), np.ones(len(ohms))])
            solved = least_squares(residual, start, x_scale=scales, max_nfev=15).x
            free = np.asarray(solved[:n_params], float)
            ohms = np.asarray(np.exp(np.clip(solved[n_params:], *bounds)), float)
        unbridged = design @ free
        predicted = _bridged(unbridged, wiring.bridges, ohms)
        squares = float(np.sum(((predicted - self.measured) * self._weight) ** 2))
        return WiringFit(
            replace(wiring, ohms=tuple(ohms.tolist())),
            scale=float(free[0]),
            series=free[n_sheet:],
            around=self._around[list(wiring.order)],
            predicted=predicted,
            unbridged=unbridged,
            squares=squares,
            misfit=float(np.sqrt(squares / max(1, len(self.measured) - n_params - len(ohms)))),
        )

    def _design(self, order: Sequence[int]) -> Floats:
        """The design (n_pairs, n_params) if terminal k goes to electrode order[k]; series resistances stay."""
        to = np.array(order)[self.pairs]
        return np.hstack([self._columns[pair_index(to[:, 0], to[:, 1], self.n)], self._ends])

    def _solved(self, design: Floats, ohms: Floats, kept: NDArray[np.bool_]) -> Floats:
        """The parameters (n_params,) that fit resistances (n_pairs,) best, of the pairs kept."""
        weight = self._weight[kept]
        return np.asarray(np.linalg.lstsq(design[kept] * weight[:, None], ohms[kept] * weight, rcond=None)[0], float)

    def _not_bridged(self, wiring: WiringHypothesis) -> NDArray[np.bool_]:
        """Which pairs (n_pairs,) have no bridged terminal."""
        return np.asarray(~np.isin(self.pairs, wiring.bridges).any(axis=1))

    def _across(self, bridges: Sequence[tuple[int, int]]) -> Floats:
        """The resistances measured across bridges (ohm)."""
        a, b = np.array(bridges, np.int64).reshape(-1, 2).T
        return np.asarray(self.measured[pair_index(a, b, self.n)])


@lru_cache(maxsize=4)
def _sheet(skin: Skin) -> tuple[Floats, Floats]:
    """Of the untouched sheet: resistance (n_elec,) from each electrode to all others; columns (n_pairs, 6).

    The columns are the pair resistances, and their change with a conductivity that varies linearly and quadratically.
    """
    mesh = skin.mesh_for(skin.discs, _MESH * skin.imaging.mesh_size)
    model = TransferModel(mesh, skin.discs, skin.sheet.conductivity)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    x, y = ((mesh.centroids - (low + high) / 2) / ((high - low).max() / 2)).T
    slow = np.column_stack([x, y, x * x, x * y, y * y]) * model.conductivity[:, None]
    columns = np.column_stack([model.pair_resistances, model.pair_sensitivity @ slow])
    return np.diag(model.transfer_resistance).copy(), columns


def typical_resistance(skin: Skin) -> float:
    """The median two-terminal resistance of the untouched sheet as described (ohm)."""
    return float(np.median(_sheet(skin)[1][:, 0]))


def _bridged(resistances: Floats, bridges: Sequence[tuple[int, int]], ohms: Floats) -> Floats:
    """Pair resistances (n_pairs,) with some terminals bridged."""
    if not bridges:
        return resistances
    n = round((1 + np.sqrt(1 + 8 * len(resistances))) / 2)
    i, j = all_pairs(n).T
    gram = np.zeros((n, n))
    gram[i, j] = gram[j, i] = -resistances / 2
    for (a, b), r in zip(bridges, ohms, strict=True):
        across = gram[:, a] - gram[:, b]
        gram = gram - np.outer(across, across) / max(across[a] - across[b] + r, 1e-9)
    return two_terminal(gram)
