"""The physics of a pressed sheet: area electrodes, and floating patches that short the sheet where they are pressed on it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ohmskin.errors import SkinError
from ohmskin.forward.assembly import factorise, stiffness
from ohmskin.geometry import mesh_domain
from ohmskin.geometry.domain import Floats
from ohmskin.skin.description import Skin

_SAMPLES = 4  # points along each side of a patch at which it touches the sheet


@dataclass(frozen=True)
class Press:
    """Something round that presses on the skin.

    Args:
        position: Centre (x, y) in metres.
        radius: Radius in metres.
        pressure: Pressure in pascals.

    Raises:
        SkinError: If a value is not finite or out of range.
    """

    position: tuple[float, float]
    radius: float
    pressure: float

    def __post_init__(self) -> None:
        if not np.isfinite([*self.position, self.radius, self.pressure]).all():
            raise SkinError(f"{self} has a value that is not finite")
        if not 0 < self.radius <= 1:
            raise SkinError(f"press radius is {self.radius} m; it must be above 0 and at most 1 m")
        if not 0 <= self.pressure <= 1e7:
            raise SkinError(f"press pressure is {self.pressure} Pa; it must be 0 to 10 MPa")


class PressedSheet:
    """Transfer resistances of a sheet under any presses, exact on its mesh and cheap for each new press.

    Electrodes and patches are the same thing to the sheet: conductors of one potential each, joined to it by a conductance
    per area. Electrodes stay, so they are factorised in (complete electrode model). Patches come and go as an update of low
    rank: at the points where they touch, with conductances M (a floating patch takes its mean potential out), the Green's
    matrix G of the untouched sheet and the potentials X that the electrodes cause there,

        R = R_0 - X^T M (I + G M)^-1 X.

    Args:
        skin: What to model. The sheet's mesh has finer edges than the estimator's and no node at the electrodes.

    Attributes:
        untouched: (n_elec, n_elec) transfer resistances of the untouched skin in ohms, contact impedances included; the last
            electrode is the reference.
    """

    def __init__(self, skin: Skin) -> None:
        self.skin = skin
        self.mesh = mesh_domain(skin.domain, 0.66 * skin.imaging.mesh_size)
        n, n_elec = self.mesh.n_nodes, len(skin.electrodes)
        system = stiffness(self.mesh, np.full(self.mesh.n_elem, skin.sheet.conductivity))
        load, total = np.zeros((n, n_elec)), np.zeros(n_elec)
        for k, centre in enumerate(skin.electrodes.positions):
            at, area = self._interpolation(_square_lattice(centre, 2 * skin.electrode.radius, 16, within=skin.electrode.radius))
            joint = area / skin.electrode.contact_resistivity
            system = system + joint * (at.T @ at)
            load[:, k], total[k] = joint * at.sum(axis=0), joint * at.shape[0]
        system = sp.block_array([[system, -load], [-load.T, np.diag(total)]], format="csc")
        last = n + n_elec - 1
        inverse = factorise(system[:last, :last]).solve(np.eye(last))
        self.untouched: Floats = np.zeros((n_elec, n_elec))
        self.untouched[:-1, :-1] = inverse[n:, n:]
        self._green: Floats = np.ascontiguousarray(inverse[:n, :n])
        self._caused: Floats = np.hstack([inverse[:n, n:], np.zeros((n, 1))])
        self._lay_patches()

    def _interpolation(self, lattice: tuple[Floats, float]) -> tuple[sp.csr_array, float]:
        """Rows (n_points, n_nodes) that interpolate nodal values at those lattice points that lie on the sheet."""
        points, area = lattice
        element, barycentric = self.mesh.locate(points)
        inside = element >= 0
        row = np.repeat(np.arange(int(inside.sum())), 3)
        column = self.mesh.triangles[element[inside]].ravel()
        return sp.csr_array((barycentric[inside].ravel(), (row, column)), shape=(int(inside.sum()), self.mesh.n_nodes)), area

    def _lay_patches(self) -> None:
        layer, (x0, y0, x1, y1) = self.skin.contact_layer, self.skin.domain.bounds
        centres = [
            (x0 + (i + 0.5) * (x1 - x0) / layer.columns, y0 + (j + 0.5) * (y1 - y0) / layer.rows)
            for j in range(layer.rows)
            for i in range(layer.columns)
        ]
        offsets, area = _square_lattice(np.zeros(2), layer.patch, _SAMPLES)
        points = (np.array(centres)[:, None] + offsets).reshape(-1, 2)
        patch = np.repeat(np.arange(len(centres)), len(offsets))
        inside = self.mesh.locate(points)[0] >= 0
        self._points, self._patch = points[inside], patch[inside]
        self._at_points, self._point_area = self._interpolation((self._points, area))

    @property
    def contact_points(self) -> Floats:
        """Points (n_points, 2) at which the patches touch the sheet when pressed (m)."""
        return self._points

    def transfer_resistance(self, presses: Iterable[Press]) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under any number of presses; the last electrode is the reference."""
        spread = self.skin.contact_layer.foam_spread
        pressure = np.zeros(len(self._points))
        for press in presses:
            distance = np.linalg.norm(self._points - press.position, axis=1)
            share = (press.radius + spread - distance) / max(spread, 1e-12)  # the foam spreads the edge of the press
            pressure += press.pressure * np.clip(share, 0.0, 1.0)
        return self.under_pressure(pressure)

    def under_pressure(self, pressure: Floats) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under a pressure (n_points,) in pascals at the `contact_points`."""
        layer = self.skin.contact_layer
        touching = np.flatnonzero(pressure > 0)
        if not len(touching):
            return self.untouched
        joint = self._point_area * layer.conductance * (pressure[touching] / layer.pressure_scale) ** layer.exponent
        _, patch = np.unique(self._patch[touching], return_inverse=True)
        same = patch[:, None] == patch[None, :]
        per_patch = np.bincount(patch, joint)[patch]
        conductance = np.diag(joint) - same * np.outer(joint, joint / per_patch)

        rows = self._at_points[touching]
        nodes = np.unique(rows.indices)
        local = rows[:, nodes].toarray()
        green = local @ self._green[np.ix_(nodes, nodes)] @ local.T
        caused = local @ self._caused[nodes]
        change = caused.T @ conductance @ np.linalg.solve(np.eye(len(joint)) + green @ conductance, caused)
        resistance: Floats = self.untouched - (change + change.T) / 2
        return resistance


def _square_lattice(centre: Floats, side: float, count: int, within: float = np.inf) -> tuple[Floats, float]:
    """Centres (n, 2) of count x count cells of a square, those `within` a radius, and the area that each stands for (m2)."""
    step = (np.arange(count) + 0.5) / count * side - side / 2
    offset = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    return centre + offset[np.linalg.norm(offset, axis=1) <= within], (side / count) ** 2
