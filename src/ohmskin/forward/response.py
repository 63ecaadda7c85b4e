"""What a small contact anywhere on a flat sheet does to the data: a table made once, read in microseconds.

A contact is a disc that changes the conductivity by a share e over an area a; to first order its effect on the
resistance of every electrode pair is e a times the mean, over the disc, of the sensitivity per area. Cubic splines
over the sheet at eight radii hold it; between them it is nearly linear in r^2 (the mean of f over a disc is f + r^2/8
laplace f + ...).
"""

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ohmskin.arrays import Floats, Ints, Singles
from ohmskin.cache import cached
from ohmskin.errors import ModelError
from ohmskin.forward.splines import Grid, Spline, lopsided, respond_at
from ohmskin.forward.transfer import TransferModel
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.geometry.periodic import shortest
from ohmskin.scan import Pairs

_SPREAD = np.array([0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0])  # radii kept, in usual ones
_BLOCK = 256  # pairs of which the table is made at once: memory
_WHOLE = 0.995  # share of a disc on the sheet that counts as all of it; meshes cut round rims short
_LEAST_COVER = 0.25  # share of a disc that must lie on the sheet; places beyond take the closest such place's response


@dataclass(frozen=True, eq=False)
class ContactResponse:
    """Responses of n contacts per square metre of their effect (relative conductivity change times area).

    Args:
        values: (n, n_pairs) change of the two-terminal resistances (ohm/m2).
        slopes: (n, 2, n_pairs) derivative by position (ohm/m3).
        widening: (n, n_pairs) derivative by the squared radius (ohm/m4).
    """

    values: Floats
    slopes: Floats
    widening: Floats


class ContactTable:
    """Responses of contacts anywhere on a flat sheet.

    Compared with the integrals that they approximate, they err by 0.25 % in the middle, and by up to 10 % where the
    edge of a contact crosses the triangles at a point electrode, which are not exact either.

    On a closed band any x is a place: whole turns do not count.

    Args:
        model: Of the untouched sheet; the finer its mesh (half the radius and less), the smoother the table.
        radius: Usual radius of a contact (m); responses are kept at 0.5 to 3 times it.
        pitch: Distance of the places at which responses are kept (m).

    Attributes:
        pairs: The pairs of electrodes.
        electrodes: (n_elec, 2) their middles (m).
        places: (n_places, 2) in metres, at which responses are kept; all on the sheet.
        sheet: Which part of the table's rectangle is sheet: its lowest and highest corner (2,), the pitch (2,) of a
            grid, the place closest to each of its points (n_x, n_y, 2), how far off that a position may lie (m), and
            the period of a closed band, 0 of others (m).
        period: That period (m).
        whole: (n_places,) whether a contact of the usual radius lies entirely on the sheet there.

    Raises:
        ModelError: If the sheet is not flat, or `radius` or `pitch` are out of range.
    """

    def __init__(self, model: TransferModel, radius: float = 8e-3, pitch: float = 2.5e-3) -> None:
        mesh = model.mesh
        if mesh.nodes.shape[1] != 2:
            raise ModelError("a contact table needs a flat sheet; on surfaces in space find contacts in an image")
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        if mesh.period:
            low[0], high[0] = 0.0, mesh.period
        if not (0 < pitch < (high - low).min() / 4 and 0 < radius < (high - low).min() / 2):
            allowed = "the radius must be below half of its shorter side and the pitch below a quarter"
            raise ModelError(f"radius {radius!r} m and pitch {pitch!r} m; on a sheet of {high - low} m {allowed}")
        self.radius, self.n_elec, self.period = radius, len(model.electrodes), mesh.period
        self.pairs = model.pairs
        self.electrodes: Floats = model.electrodes.positions
        self._low = low
        self._steps = np.ceil((high - low) / pitch - 1e-9).astype(int)  # at least four
        self._pitch = (high - low) / self._steps
        counts = self._steps + np.array([self.period == 0, 1])  # the last place round a closed band is the first
        axes = [low[k] + self._pitch[k] * np.arange(counts[k]) for k in range(2)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        model = model.shorted
        covered, spread = list[Floats](), []
        for share in _SPREAD:
            r = share * radius
            cover = disc_overlap(mesh, grid.reshape(-1, 2), r)
            area = cover.sum(axis=1)
            cover = sp.diags_array(1 / np.maximum(area, 1e-300)) @ cover
            covered.append(area / (np.pi * r**2))
            off = (covered[-1] < _LEAST_COVER * (1 - 1e-9)).reshape(grid.shape[:2])
            closest = _closest_on(off, self._pitch, self.period > 0)
            spread.append((cover, closest))
            if share == 1.0:
                field = (cover @ _fields(model)).reshape(*grid.shape[:2], -1)[closest[0], closest[1]]
                self._fields = _knots(field, self.period > 0)
        # rounded to 6e-8 of each: half the memory to hold and to read
        self._knots: Singles = np.empty((*self._fields.shape[:2], len(_SPREAD), len(self.pairs)), np.float32)
        for start in range(0, len(self.pairs), _BLOCK):
            some = slice(start, start + _BLOCK)
            part = model.over(Pairs.of(self.n_elec, self.pairs.ends[some]))
            density = (part.pair_sensitivity * (model.conductivity / mesh.measures)).T
            for layer, (cover, closest) in enumerate(spread):
                values = (cover @ density).reshape(*grid.shape[:2], -1)[closest[0], closest[1]]
                self._knots[:, :, layer, some] = _knots(values, self.period > 0)
        usual = list(_SPREAD).index(1.0)
        # the smallest disc says best whether its centre is on the sheet
        inside = covered[0] >= _LEAST_COVER * (1 - 1e-9)
        self.places: Floats = grid.reshape(-1, 2)[inside]
        self.whole: NDArray[np.bool_] = covered[usual][inside] > _WHOLE
        self._gain = 1.0
        off = ~inside.reshape(grid.shape[:2])
        row, column = _closest_on(off, self._pitch, self.period > 0)
        reach = radius if off.any() else np.inf
        self.sheet: Grid = low, high, self._pitch, np.ascontiguousarray(grid[row, column]), reach, self.period

    @classmethod
    def kept(cls, model: TransferModel, radius: float, pitch: float) -> "ContactTable":
        """The same, made once on this machine: see `cached`. Arguments and errors as of `ContactTable`."""
        mesh, electrodes = model.mesh, model.electrodes.positions
        solved = model.gradients, model.conductivity, model.potentials, model.electrode_potentials
        read = mesh.nodes, mesh.elements, mesh.period, *solved, electrodes, model.pairs.ends, radius, pitch
        found = cached("contacts", read, lambda: cls(model, radius, pitch)._arrays())
        table = object.__new__(cls)
        table.radius, table.n_elec, table.period, table._gain = radius, len(model.electrodes), mesh.period, 1.0
        table.pairs, table.electrodes = model.pairs, electrodes
        high, closest, reach = (found.pop(name) for name in ("high", "closest", "reach"))
        vars(table).update(found)
        table.sheet = table._low, high, table._pitch, closest, float(reach), table.period
        return table

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """All that takes time to make."""
        names = ("_low", "_steps", "_pitch", "_fields", "_knots", "places", "whole")
        _, high, _, closest, reach, _ = self.sheet
        rest = {"high": high, "closest": closest, "reach": np.array(reach)}
        return {name: getattr(self, name) for name in names} | rest

    @property
    def content(self) -> tuple[Floats | Singles | Ints | float, ...]:
        """All that tells it from other tables."""
        grid = self.sheet[:4]
        return self._knots, self._fields, self._gain, self.radius, self.period, *grid, self.places, self.pairs.ends

    def scaled(self, factor: float) -> "ContactTable":
        """The table of the same sheet with all conductances multiplied by `factor`, as `TransferModel.scaled`."""
        other = copy(self)
        other._gain = self._gain / factor
        other._fields = self._fields / np.sqrt(factor)
        return other

    def spaced(self, spacing: float) -> Ints:
        """Numbers (n,) of places, one in each square of a grid: the one closest to the square's middle.

        Args:
            spacing: Side of a square (m).
        """
        low, width = self.places.min(axis=0), np.ptp(self.places, axis=0)
        width[0] = self.period or width[0]
        many = np.maximum(np.rint(width / spacing), 1)
        cell = (self.places - low) / width * many
        order = np.argsort(np.linalg.norm(cell - np.rint(cell), axis=1), kind="stable")
        wrapped = np.rint(cell) % [many[0] if self.period else np.inf, np.inf]
        _, first = np.unique(wrapped[order], axis=0, return_index=True)
        return np.sort(order[first])

    @property
    def spline(self) -> Spline:
        """What `respond` reads."""
        squares = (_SPREAD * self.radius) ** 2
        return (
            self._knots,
            self._low,
            self._pitch,
            self._steps,
            self.period,
            squares,
            self._gain,
            self._fields,
            self.pairs.ends,
        )

    def offsets(self, ends: ArrayLike, starts: ArrayLike) -> Floats:
        """Vectors (..., 2) from `starts` (..., 2) to `ends` (..., 2) (m), round a closed band the short way."""
        return shortest(np.asarray(ends, float) - np.asarray(starts, float), self.period)

    def __call__(self, positions: ArrayLike, radius: ArrayLike | None = None) -> ContactResponse:
        """Responses of contacts.

        Args:
            positions: (n, 2) in metres; one off the table's rectangle counts as the closest in it.
            radius: One or (n,) (m); the usual one unless given, at most three times that.
        """
        positions = np.asarray(positions, float).reshape(-1, 2)
        r = np.minimum(np.asarray(self.radius if radius is None else radius, float), _SPREAD[-1] * self.radius)
        found = np.empty((len(positions), 4, self._knots.shape[-1]))
        respond_at(np.column_stack([positions, np.broadcast_to(r**2, len(positions))]), self.spline, found)
        return ContactResponse(found[:, 2], found[:, :2], found[:, 3])

    def lopsided(self, positions: ArrayLike) -> Floats:
        """Changes (2 n, n_pairs) due to contacts at positions (n, 2) (m) that conduct better in one direction.

        Per square metre of effect (ohm/m2): for each contact the change due to conducting along x instead of y, then
        the same for the diagonals. A disc has no such part; in a line-shaped contact it is as large as the effect.
        """
        places = np.asarray(positions, float).reshape(-1, 2)
        out = np.empty((2 * len(places), len(self.pairs)))
        lopsided(places, self._fields, self._low, self._pitch, self._steps, self.period, self.pairs.ends, out)
        return out


def _closest_on(off: NDArray[np.bool_], pitch: Floats, closed: bool) -> tuple[Ints, Ints]:
    """Numbers (n_x, n_y) along x and along y of the place not `off` (n_x, n_y) that is closest to each of a grid."""
    from scipy.ndimage import distance_transform_edt  # takes a tenth of a second, which kept tables need not wait

    turns = 3 if closed else 1
    around = np.concatenate([off] * turns)
    x, y = distance_transform_edt(around, sampling=pitch, return_distances=False, return_indices=True)
    middle = slice(len(off) * (turns // 2), len(off) * (turns // 2 + 1))
    return x[middle] % len(off), y[middle]


def _knots(values: Floats, closed: bool) -> Floats:
    """Coefficients of the cubic spline through values on a grid (n_x, n_y, ...), with those beyond its border."""
    from scipy.ndimage import spline_filter1d  # as in `_closest_on`

    for axis in (0, 1):
        round_it = closed and axis == 0
        values = spline_filter1d(values, order=3, axis=axis, mode="grid-wrap" if round_it else "mirror")
        pad = [(0, 0)] * values.ndim
        pad[axis] = (1, 3 if round_it else 2)
        values = np.pad(values, pad, mode="wrap" if round_it else "reflect")
    return values


def _fields(model: TransferModel) -> Floats:
    """Field (n_elem, 2 n_elec) of 1 A into each electrode, first along x, times the root of the conductivity."""
    caused = np.einsum("ekd,ekn->edn", model.gradients, model.potentials[model.mesh.elements])
    return np.asarray((np.sqrt(model.conductivity)[:, None, None] * caused).reshape(len(caused), -1))


def effective_change(log_ratio: ArrayLike, dim: int = 2) -> tuple[Floats, Floats]:
    """dim (rho - 1) / (rho + dim - 1) of a conductivity ratio rho and its derivative, both by log rho.

    A disc of that ratio disturbs a field as this times its area does to first order: in the plane exactly, whatever
    the field (every multipole has the same factor), a ball in a uniform one. Left out is its influence on itself by
    way of the rim, and on other discs.
    """
    ratio = np.exp(np.asarray(log_ratio, float))
    return dim * (ratio - 1) / (ratio + dim - 1), dim**2 * ratio / (ratio + dim - 1) ** 2
