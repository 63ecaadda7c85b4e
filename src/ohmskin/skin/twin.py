"""The physics of a pressed sheet: area electrodes, and floating patches that short the sheet where they are pressed."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.errors import SkinError
from ohmskin.forward import FloatingPatches, TransferModel
from ohmskin.geometry.periodic import folded, shortest, tree
from ohmskin.scan import two_terminal
from ohmskin.skin.checks import check_patches
from ohmskin.skin.description import Skin
from ohmskin.skin.layer import ContactLayer

_PLACES, _GRADED = 4, 0.5  # places along each side of a contact where the pressure is looked at; 0 is even, 1 a cosine
_PREPARED = 1000  # patches
MOST_PRESSURE = 1e7  # Pa
_MARGIN = 1.3  # by which the scale of a map may change within the reach of a press
_LEAST_SPREAD = 0.5e-3  # m, of the foam where slopes are asked for: the edge of a press must not be a step


Load = tuple[tuple[float, float], float, Callable[[Floats], Floats]]


@dataclass(frozen=True)
class Press:
    """A round indenter pressed on the skin.

    Args:
        position: Centre (x, y) in metres, on the skin's map.
        radius: Radius in metres, on the skin.
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
        if not 0 <= self.pressure <= MOST_PRESSURE:
            raise SkinError(f"press pressure is {self.pressure} Pa; it must be 0 to 10 MPa")

    def force(self, foam_spread: float = 0.0) -> float:
        """The force (N), if all of the press is on the sheet: the integral of the pressure.

        Args:
            foam_spread: Width of the ring round the press in which the pressure falls to nothing (m),
                `ContactLayer.foam_spread`.
        """
        inner, outer = self.radius, self.radius + foam_spread
        return self.pressure * float(np.pi) * (inner**2 + inner * outer + outer**2) / 3  # a frustum of a cone

    def pressure_at(self, distance: Floats, spread: float) -> Floats:
        """Pressure (...) (Pa) at some distance from the centre.

        Args:
            distance: (...) in metres.
            spread: Width of the ring outside the radius in which foam lets the pressure fall to 0 (m).
        """
        return np.asarray(self.pressure * np.clip((self.radius + spread - distance) / max(spread, 1e-12), 0.0, 1.0))


class PressedSheet:
    """Transfer resistances of a sheet under any presses, exact on its mesh and cheap for each new press.

    Electrodes are discs with contact impedance (`TransferModel`), patches floating conductors (`FloatingPatches`).

    Args:
        skin: What to model.
        contact_factors: Factor on each electrode's contact impedance (n_elec,), for poor contacts.
        model: Of the untouched sheet with its electrodes and their contacts; on a mesh finer than the estimator's, with
            `contact_factors`, unless given.
        contacts: Their number along each side of a patch, closer at its edges, where the current enters.

    Attributes:
        untouched: (n_elec, n_elec) transfer resistances of the untouched skin in ohms, contact impedances included;
            the last electrode is the reference.
    """

    def __init__(
        self, skin: Skin, contact_factors: ArrayLike = 1.0, model: TransferModel | None = None, contacts: int = 6
    ) -> None:
        layer, size = skin.contact_layer, 0.66 * skin.imaging.mesh_size
        check_patches(layer.number_on(skin.chart), 1.15 * min(layer.patch**2, skin.domain.area) / size**2)
        if model is None:
            mesh = skin.mesh_for(skin.discs, size)
            factors = np.broadcast_to(np.asarray(contact_factors, float), len(skin.electrodes))
            electrodes = skin.discs.with_contact_impedances(skin.discs.contact_impedances * factors)
            model = TransferModel(mesh, electrodes, skin.conductivity_on(mesh))
        self.skin, self.mesh = skin, model.mesh
        self._patches = FloatingPatches(model, *self._contacts(contacts))
        scale = skin.chart.scale(self._patches.points)
        a, b = self._patches.sizes.transpose(1, 2, 0)
        self._areas: Floats = (a[0] * b[1] - a[1] * b[0]) * scale**2
        here, _ = model.mesh.locate(self._patches.points)
        self._spreading: Floats = 1 / (4 * np.pi * model.conductivity[here])  # ohm
        places = ((np.arange(_PLACES) + 0.5) / _PLACES - 0.5)[:, None] * np.ones(_PLACES)
        offsets = np.stack([places.T.ravel(), places.ravel()], axis=1)
        self._places: Floats = self._patches.points[:, None] + offsets @ self._patches.sizes
        self._tree = tree(self._patches.points, skin.domain.period)
        self._unprepared = iter(np.unique(self._patches.patches)[:_PREPARED].tolist())
        self._reach = float(np.linalg.norm(self._patches.sizes, axis=(1, 2)).max()) / 2
        self.untouched: Floats = _against_last(model.transfer_resistance)
        # compile now: a device that compiles at its first touch is taken for one that is lost
        # at one place and not by a press, which foam may spread over all patches
        x, y = self._patches.points[len(self._patches.points) // 2].tolist()
        self.under([((x, y), 0.0, lambda places: np.ones(places.shape[:-1]))])

    def _contacts(self, count: int) -> tuple[Floats, Ints, Floats]:
        """Middles (n, 2) of the contacts between patches and sheet, the patch (n,) of each, its sides (n, 2, 2)."""
        even = np.arange(count + 1) / count
        ends = (1 - _GRADED) * (even - 0.5) - _GRADED / 2 * np.cos(np.pi * even)
        points, sides = self.skin.contact_layer.patches(self.skin.chart).divided(ends)
        numbers = np.repeat(np.arange(len(points)), count * count)
        return points.reshape(-1, 2), numbers, sides.reshape(-1, 2, 2)

    def transfer_resistance(self, presses: Iterable[Press]) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under presses; the last electrode is the reference."""
        return self.under(self._loads(presses))

    def many(self, cases: Sequence[Iterable[Press]]) -> Floats:
        """(n, n_elec, n_elec) `transfer_resistance` of n `cases` of presses, in one compiled pass."""
        closed = [self._closed(self._loads(presses)) for presses in cases]
        return np.array([_against_last(one) for one in self._patches.many(closed)])

    def under(self, loads: Iterable[Load]) -> Floats:
        """(n_elec, n_elec) transfer resistances in ohms under loads of any shape, whose pressures add up.

        Args:
            loads: Of each its place (2,), how far it reaches from there (m), and its pressure (...) (Pa) at points
                (..., 2) (m) of the skin's map.
        """
        touching, closed = self._closed(loads)
        if not touching.size:
            return self.untouched
        conductance = np.zeros(len(self._places))
        conductance[touching] = closed
        return _against_last(self._patches.transfer_resistance(conductance))

    def _loads(self, presses: Iterable[Press]) -> Iterator[Load]:
        spread = self.skin.contact_layer.foam_spread

        def pressure_at(points: Floats, press: Press) -> Floats:
            return press.pressure_at(self.distances(points, press), spread)

        for press in presses:
            yield press.position, press.radius + spread, partial(pressure_at, press=press)

    def _closed(self, loads: Iterable[Load]) -> tuple[Ints, Floats]:
        """Contacts (m,) of patches that loads close, rising, and the conductance (m,) of each (S)."""
        parts = [(np.array(self._near(place, reach), int), pressure_at) for place, reach, pressure_at in loads]
        near = np.unique(np.concatenate([np.empty(0, int), *(own for own, _ in parts)]))
        pressure = np.zeros((len(near), self._places.shape[1]))
        for own, pressure_at in parts:
            pressure[np.searchsorted(near, own)] += pressure_at(self._places[own])
        touched = pressure.any(axis=1)
        touching = near[touched]
        return touching, self._joined(self._conductance(pressure[touched]), touching)[0]

    def _joined(self, per_area: Floats, contacts: Ints) -> tuple[Floats, Floats]:
        """Conductance (m,) (S) of contacts with some per area (m, n_places) (S/m2), and its slopes by each of these.

        Where only a share of a contact's area conducts, current enters there alone: its mean potential is the logarithm
        over an area so much smaller.
        """
        mean, square = per_area.mean(axis=1), (per_area**2).mean(axis=1)
        areas, spreading, count = self._areas[contacts], self._spreading[contacts], per_area.shape[1]
        whole = 1 / (1 / (mean * areas) + spreading * np.log(square / mean**2))
        slopes = (1 / areas + 2 * spreading * mean)[:, None] / mean[:, None] ** 2
        slopes = slopes - 2 * spreading[:, None] * per_area / square[:, None]
        return whole, slopes * whole[:, None] ** 2 / count

    def with_layer(self, layer: ContactLayer) -> "PressedSheet":
        """The same sheet under a layer of the same patches with another conductance; nothing is computed again."""
        other = copy(self)
        other.skin = replace(self.skin, contact_layer=layer)
        return other

    def linearised(self, presses: Sequence[Press], groups: Ints | None = None) -> tuple[Floats, Floats]:
        """Changes of two-terminal resistances (n_pairs,) due to presses (ohm), and their slopes (n_pairs, 4 n + 2).

        Slopes are by x, y (per m), the logarithms of radius and pressure of each press, then by the logarithm of the
        layer's conductance and by its exponent.

        Args:
            presses: The presses (n,).
            groups: (n,) numbers of groups that are far from each other, so that what each does to others is small:
                it is in the changes, to first order, and not in the slopes. None: all are solved for together.
        """
        layer = self.skin.contact_layer
        spread = max(layer.foam_spread, _LEAST_SPREAD)
        near = self._near_any((press.position, press.radius + spread) for press in presses)
        pressure, parts = np.zeros((len(near), self._places.shape[1])), np.zeros((len(presses), len(near)))
        slopes = np.zeros((4 * len(presses), *pressure.shape))
        for k, press in enumerate(presses):
            away = self._away(self._places[near], press)
            distance = np.linalg.norm(away, axis=-1)
            own = press.pressure_at(distance, spread)
            rising = np.where((own > 0) & (own < press.pressure), press.pressure / spread, 0.0)
            pressure += own
            parts[k] = own.sum(axis=1)
            here = float(self.skin.chart.scale([press.position])[0])  # metres on the skin for one on the map
            for axis in range(2):
                slopes[4 * k + axis] = here * rising * away[..., axis] / np.maximum(distance, 1e-12)
            slopes[4 * k + 2], slopes[4 * k + 3] = rising * press.radius, own
        touched = pressure.any(axis=1)
        at, slopes, touching = pressure[touched], slopes[:, touched], near[touched]
        per_area = self._conductance(at)
        logarithm = np.log(np.maximum(at, 1e-300) / layer.pressure_scale)
        by_pressure = layer.exponent * per_area / np.maximum(at, 1e-300)
        changes = [*(by_pressure * slope for slope in slopes), per_area, per_area * logarithm]
        conductance = np.zeros(len(self._places))
        conductance[touching], rises = self._joined(per_area, touching)
        apart: Ints = np.zeros(len(self._places), int)
        apart[near] = 0 if groups is None or not len(near) else groups[parts.argmax(axis=0)]
        after, volts = self._patches.linearised(conductance, apart)
        pairs = self._patches.model.pairs
        i, j = pairs.ends.T
        seen = (volts[:, i] - volts[:, j]) ** 2
        return (
            two_terminal(after, pairs) - self._patches.model.pair_resistances,
            -seen.T @ np.array([(change * rises).sum(axis=1) for change in changes]).T,
        )

    def contacts_under(self, presses: Iterable[Press]) -> int:
        """Number of contacts that presses may close; the time of a press grows with about its cube."""
        spread = self.skin.contact_layer.foam_spread
        return len(self._near_any((press.position, press.radius + spread) for press in presses))

    def prepare(self) -> None:
        """`FloatingPatches.prepare` of one more patch.

        For a thousand patches at most, because memory grows with the square of their number.
        """
        if (patch := next(self._unprepared, None)) is not None:
            self._patches.prepare(patch)

    def distances(self, places: Floats, press: Press) -> Floats:
        """How far (...) places (..., 2) of the map are from the middle of a press, on the skin (m)."""
        return np.asarray(np.linalg.norm(self._away(places, press), axis=-1))

    def _away(self, places: Floats, press: Press) -> Floats:
        """Vectors (..., 2) from the middle of a press to places (..., 2) of the map, as long as on the skin (m)."""
        chart = self.skin.chart
        away = shortest(places - np.array(press.position), chart.domain.period)
        if chart.flat:
            return away
        middle = (np.array(press.position) + away / 2).reshape(-1, 2)
        return np.asarray(chart.scale(middle).reshape(*away.shape[:-1], 1) * away)

    def _near_any(self, circles: Iterable[tuple[ArrayLike, float]]) -> Ints:
        """Contacts that something round may touch, each once."""
        found = [self._near(position, reach) for position, reach in circles]
        return np.unique(np.concatenate([np.array(one, int) for one in found]))

    def _near(self, position: ArrayLike, reach: float) -> list[int]:
        """Contacts that something round may touch."""
        chart = self.skin.chart
        place = folded(np.asarray(position, float), chart.domain.period)
        if not chart.flat:  # a map's scale changes little over a press
            reach *= _MARGIN / float(chart.scale([place])[0])
        return list(self._tree.query_ball_point(place, reach + self._reach))

    def _conductance(self, pressure: Floats) -> Floats:
        """Conductance per area (S/m2) under a pressure (Pa)."""
        layer = self.skin.contact_layer
        return layer.conductance * (pressure / layer.pressure_scale) ** layer.exponent


def _against_last(resistance: Floats) -> Floats:
    """The same transfer resistances with the last electrode as the reference."""
    against: Floats = resistance - resistance[-1] - resistance[:, -1:] + resistance[-1, -1]
    return against
