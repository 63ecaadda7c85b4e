"""The physics of a pressed sheet: area electrodes, and floating patches that short the sheet where they are pressed."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import SkinError
from ohmskin.forward import FloatingPatches, TransferModel
from ohmskin.skin.description import Skin

# Contacts along each side of a patch, closer at its edges, where the current enters, and places along each side of a
# contact at which the pressure is looked at: presses of 5 mm and more do to 1.5 % what they do with ever more of them.
_CONTACTS, _PLACES, _GRADED = 8, 3, 0.8


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

    def force(self, foam_spread: float = 0.0) -> float:
        """The force (N) with which it presses, if all of it is on the sheet: the integral of the pressure.

        Args:
            foam_spread: Width of the ring round the press in which the pressure falls to nothing (m),
                `ContactLayer.foam_spread`.
        """
        inner, outer = self.radius, self.radius + foam_spread
        return self.pressure * float(np.pi) * (inner**2 + inner * outer + outer**2) / 3  # a frustum of a cone

    def pressure_at(self, points: Floats, spread: float) -> Floats:
        """Pressure (...) at points (..., 2) in metres; foam lets it fall to 0 over `spread` beyond the edge (m, Pa)."""
        distance = np.linalg.norm(points - np.array(self.position), axis=-1)
        return np.asarray(self.pressure * np.clip((self.radius + spread - distance) / max(spread, 1e-12), 0.0, 1.0))


class PressedSheet:
    """Transfer resistances of a sheet under any presses, exact on its mesh and cheap for each new press.

    Electrodes are discs with contact impedance (`TransferModel`), patches floating conductors (`FloatingPatches`).

    Args:
        skin: What to model. The sheet's mesh has finer edges than the estimator's.
        contact_factors: Factor on each electrode's contact impedance (n_elec,), for poor contacts.

    Attributes:
        untouched: (n_elec, n_elec) transfer resistances of the untouched skin in ohms, contact impedances included;
            the last electrode is the reference.
        contact_points: (n_points, 2) places at which the pressure of patches on the sheet counts (m).
    """

    def __init__(self, skin: Skin, contact_factors: ArrayLike = 1.0) -> None:
        self.skin = skin
        self.mesh = skin.mesh_for(skin.discs, 0.66 * skin.imaging.mesh_size)
        factors = np.broadcast_to(np.asarray(contact_factors, float), len(skin.electrodes))
        resistivity = skin.electrode.contact_resistivity * factors
        electrodes = skin.discs.with_contact_impedances(resistivity)
        model = TransferModel(self.mesh, electrodes, skin.conductivity_on(self.mesh))
        self._patches = FloatingPatches(model, *self._contacts())
        self._areas = self._patches.sizes.prod(axis=1)
        places = ((np.arange(_PLACES) + 0.5) / _PLACES - 0.5)[:, None] * np.ones(_PLACES)
        offsets = np.stack([places.T.ravel(), places.ravel()], axis=1)
        self.contact_points: Floats = (self._patches.points[:, None] + offsets * self._patches.sizes[:, None]).reshape(
            -1, 2
        )
        self._tree = cKDTree(self._patches.points)
        self._reach = float(np.linalg.norm(self._patches.sizes, axis=1).max()) / 2
        self.untouched: Floats = _against_last(model.transfer_resistance)

    def _contacts(self) -> tuple[Floats, Ints, Floats]:
        """Middles (n, 2) of the contacts between patches and sheet, the patch (n,) of each, and its sides (n, 2)."""
        layer, (x0, y0, x1, y1) = self.skin.contact_layer, self.skin.domain.bounds
        x = x0 + (np.arange(layer.columns) + 0.5) * (x1 - x0) / layer.columns
        y = y0 + (np.arange(layer.rows) + 0.5) * (y1 - y0) / layer.rows
        centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        even = np.arange(_CONTACTS + 1) / _CONTACTS
        ends = layer.patch * ((1 - _GRADED) * (even - 0.5) - _GRADED / 2 * np.cos(np.pi * even))
        middle, side = (ends[1:] + ends[:-1]) / 2, np.diff(ends)
        offsets, sizes = (np.stack(np.meshgrid(one, one), axis=-1).reshape(-1, 2) for one in (middle, side))
        points = (centres[:, None] + offsets).reshape(-1, 2)
        return points, np.repeat(np.arange(len(centres)), len(offsets)), np.tile(sizes, (len(centres), 1))

    def transfer_resistance(self, presses: Iterable[Press]) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under presses; the last electrode is the reference."""
        spread, each = self.skin.contact_layer.foam_spread, _PLACES**2
        pressure = np.zeros((len(self._areas), each))
        for press in presses:
            near = self._tree.query_ball_point(press.position, press.radius + spread + self._reach)
            pressure[near] += press.pressure_at(self.contact_points.reshape(-1, each, 2)[near], spread)
        return self.under_pressure(pressure.ravel())

    def under_pressure(self, pressure: Floats) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under a pressure (n_points,) (Pa) at `contact_points`."""
        layer, at = self.skin.contact_layer, pressure.reshape(len(self._areas), -1)
        touching = np.flatnonzero(at.any(axis=1))
        if not len(touching):
            return self.untouched
        per_area = layer.conductance * (at[touching] / layer.pressure_scale) ** layer.exponent
        conductance = np.zeros(len(at))
        conductance[touching] = per_area.mean(axis=1) * self._areas[touching]
        return _against_last(self._patches.transfer_resistance(conductance))


def _against_last(resistance: Floats) -> Floats:
    """The same transfer resistances with the last electrode as the reference."""
    against: Floats = resistance - resistance[-1] - resistance[:, -1:] + resistance[-1, -1]
    return against
