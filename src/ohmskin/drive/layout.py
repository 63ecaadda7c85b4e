"""Where to put electrodes: for the smallest worst-case error of a contact's position, on the rim and inside.

All places where an electrode may be are electrodes of one finite-element model, factorised once. What a contact does
to a two-terminal resistance is the mean of |grad u_i - grad u_j|^2 over it, so with the means of all products grad u_i
. grad u_j kept, any layout is looked up. Layouts are mirror-symmetric about both middle lines, if the skin is.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import Floats, Ints
from ohmskin.drive.bound import ContactPrior
from ohmskin.drive.design import CURRENT, whitened
from ohmskin.drive.patterns import complete_pattern
from ohmskin.errors import GeometryError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Disc, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.geometry.band import Band, Edge
from ohmskin.geometry.domain import Domain
from ohmskin.geometry.electrodes import to_corners
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.geometry.periodic import folded, shortest
from ohmskin.geometry.spread import spread
from ohmskin.scan import all_pairs

_STEPS = 12  # candidates along the shorter side
_PLACES = 7  # of contacts, along each half of a side of the sheet
_ALIKE = 0.02  # by which the scale of a map may differ from its mirror image
_MOST = 60  # places of contacts
_AT = 1e-6  # m, within which electrodes are on a rim, or at its corner
_LEAST_ON_RIM = 4  # electrodes; fewer have no base scan
_POWER = 8.0  # of the squared errors before their mean: close to the worst, but with a slope where others can gain
_SHIFT = 0.3  # of a radius: half the step of derivatives; smaller ones see the triangles


def arranged(domain: Domain, positions: Floats) -> Electrodes:
    """Electrodes on a `domain` at positions (n, 2) in metres, numbered counterclockwise, those on the rim first.

    Electrodes within 1 um of the rim, or of a hole's, are moved onto it exactly. Those of holes
    count as inside: a base scan goes round the outer rim, of a sleeve round both ends.

    Raises:
        GeometryError: If fewer than four are on the rim, or two are at the same place.
    """
    points = np.asarray(positions, float).reshape(-1, 2)
    for hole in domain.holes:
        if not isinstance(hole, Edge) and (on_hole := np.abs(hole.depth(points)) < _AT).any():
            points = np.vstack([points[~on_hole], hole.rim(to_corners(hole, hole.arc(points[on_hole]), _AT))])
    on_rim = _on_rim(domain, points)
    rim, inside = points[on_rim], points[~on_rim]
    if len(rim) < _LEAST_ON_RIM:
        raise GeometryError(f"{len(rim)} of {len(points)} electrodes are on the rim; a base scan needs {_LEAST_ON_RIM}")
    if domain.period:  # along its lower rim, and back along the upper one
        upper = rim[:, 1] > sum(domain.bounds[1::2]) / 2
        rim = np.vstack([rim[np.lexsort((rim[:, 0], upper))][: (~upper).sum()], rim[upper][np.argsort(-rim[upper, 0])]])
    else:
        arc = np.mod(
            to_corners(domain, domain.arc(rim), _AT) + 1e-9, domain.perimeter
        )  # rounding may put the rim's start at its end
        rim = domain.rim(np.sort(arc) - 1e-9)
    inside = inside[_round(inside - points.mean(axis=0))]
    rings = [tuple(range(len(rim)))] + ([tuple(range(len(rim), len(points)))] if len(inside) else [])
    return Electrodes.at(np.vstack([rim, inside]), tuple(rings))


def _round(away: Floats) -> Ints:
    """The order (n,) in which places that are `away` (n, 2) from the middle come on a way round it."""
    turn = np.round(np.mod(np.arctan2(away[:, 1], away[:, 0]) + 3 * np.pi / 4, 2 * np.pi), 9)
    return np.lexsort((np.hypot(*away.T), turn))


class LayoutSearch:
    """Position errors of any layout, and the search for the best one.

    The error is the Cramer-Rao bound for one contact if the frame's injections are spread evenly over all
    electrode pairs: a layout is evaluated independently of a policy.

    Args:
        domain: The sheet, of a curved skin its map.
        conductivity: In siemens per square; or a function that gives it on a mesh, as `Skin.conductivity_on`.
        mesh_size: Edge length of the finite elements (m).
        radius: Of a contact (m); contacts lie wholly on the sheet.
        noise: Standard deviation of a voltage (V).
        injections: Per frame.
        current: Of each (A).
        scale: Metres on the skin for one on the map, at places of it (n, 2), of a curved skin.

    Attributes:
        sites: (n_sites, 2) where electrodes may be (m).
        on_rim: (n_sites,) whether that is on the rim.
        places: (n_places, 2) of contacts, one of each set of mirror images (m).
    """

    def __init__(
        self,
        domain: Domain,
        conductivity: float | Callable[[Mesh], Floats],
        mesh_size: float,
        radius: float,
        noise: float,
        injections: int,
        current: float = CURRENT,
        scale: Callable[[Floats], Floats] = lambda places: np.ones(len(places)),
    ) -> None:
        self.domain = domain
        self.sites, self.on_rim = _sites(domain)
        mirrors = _mirrors(domain, self.sites, scale)
        self.orbits = _orbits(domain, self.sites, mirrors)
        on_map = radius / float(np.median(scale(self.sites)))
        self.places = _places(domain, on_map, mirrors)
        mesh = mesh_domain(domain, mesh_size, self.sites)
        known = conductivity(mesh) if callable(conductivity) else conductivity
        self._prior = ContactPrior.usual(radius)
        self._unknown = np.linalg.inv(self._prior.covariance())
        self._noise, self._share, self._current, self._scale = noise, injections, current, scale
        self._products = _mean_products(TransferModel(mesh, Electrodes.at(self.sites), known), self.places, on_map)
        metres = scale(self.places)[:, None]  # an effect is so many square metres of the skin, a place metres of it
        self._products /= metres ** np.array([3, 3, 2, 2])
        self._grams: dict[int, tuple[Ints, Floats]] = {}
        self._along_rim = self._rim_order()

    def errors(self, chosen: Ints) -> Floats:
        """Position errors (n_places,) in metres with electrodes at the sites `chosen` (n_elec,)."""
        pairs, gram = self._gram(len(chosen))
        a, b = chosen[pairs]
        columns = self._products[a, a] + self._products[b, b] - 2 * self._products[a, b]  # (n_pairs, n_places, 4)
        columns = np.moveaxis(columns, 0, 1) * self._prior.effect
        information = columns.swapaxes(1, 2) @ (gram @ columns) + self._unknown
        return np.asarray(np.sqrt(np.trace(np.linalg.inv(information)[:, :2, :2], axis1=1, axis2=2)))

    def best(self, count: int) -> Electrodes:
        """The layout of `count` electrodes with the least worst error, by exchange of sites and their mirror images.

        Raises:
            GeometryError: If there are not so many sites, or fewer than four electrodes.
        """
        check_count(count, self.domain)
        found = [self._exchanged(start) for start in self._starts(count)]
        return arranged(self.domain, self.sites[min(found, key=lambda pair: pair[0])[1]])

    def _rim_order(self) -> Ints:
        """The number (n_sites,) of each site of the rim if all of them are electrodes; -1 inside."""
        sites, order = self.sites[self.on_rim], np.full(len(self.sites), -1)
        away = shortest(sites[:, None] - arranged(self.domain, sites).positions, self.domain.period)
        order[self.on_rim] = np.linalg.norm(away, axis=2).argmin(axis=1)
        return order

    def _numbered(self, chosen: Ints) -> Ints:
        """The same sites in the order in which `arranged` numbers them, in a fraction of its time."""
        on_rim = self.on_rim[chosen]
        rim, inside = chosen[on_rim], chosen[~on_rim]
        inside = inside[_round(self.sites[inside] - self.sites[chosen].mean(axis=0))]
        return np.concatenate([rim[self._along_rim[rim].argsort()], inside])

    def _gram(self, n_elec: int) -> tuple[Ints, Floats]:
        """The pairs (2, n_pairs) of so many electrodes, and what all injections say of their resistances."""
        if n_elec not in self._grams:
            complete = complete_pattern(n_elec)
            weights = whitened(complete, n_elec, self._noise, self._current)
            gram = (weights.T @ weights).toarray() * (self._share / complete.n_inj)
            self._grams[n_elec] = all_pairs(n_elec).T, gram
        return self._grams[n_elec]

    def _score(self, orbits: list[int]) -> float:
        chosen = np.concatenate([self.orbits[k] for k in orbits])
        if self.on_rim[chosen].sum() < _LEAST_ON_RIM:
            return np.inf
        return float(np.mean(self.errors(self._numbered(chosen)) ** (2 * _POWER)))

    def _starts(self, count: int) -> list[list[int]]:
        """Orbits that add up to `count` electrodes, far apart; several numbers of pairs on the middle lines."""
        size = np.array([len(orbit) for orbit in self.orbits])
        starts = []
        for wanted in _shares(count, set(size.tolist())):
            if any(not 0 <= k <= (size == n).sum() for n, k in wanted):
                continue
            start: list[int] = []
            for n, k in wanted:
                for _ in range(k):
                    start.append(self._farthest(start, np.flatnonzero(size == n)))
            starts.append(start)
        if (size == 1).all():
            away = shortest(self.sites - spread(self.domain, count, self._scale)[:, None], self.domain.period)
            even = np.unique(np.linalg.norm(away, axis=2).argmin(axis=1))
            starts += [even.tolist()] if len(even) == count else []
        return starts

    def _farthest(self, taken: list[int], among: Ints) -> int:
        """The orbit whose closest electrode, of itself or of those taken, is farthest; the rim's first."""

        def apart(k: int) -> float:
            points = self.sites[np.concatenate([self.orbits[m] for m in [*taken, k]])]
            gaps = np.linalg.norm(shortest(points[:, None] - points, self.domain.period), axis=2)
            gaps += np.diag(np.full(len(points), np.inf))
            return float(gaps.min(initial=1e9)) + (1e-6 if self.on_rim[self.orbits[k][0]] else 0.0)

        return max((int(k) for k in among if k not in taken), key=apart)

    def _exchanged(self, orbits: list[int]) -> tuple[float, Ints]:
        score, kept, at = self._score(orbits), 0, 0
        while kept < len(orbits):
            size = len(self.orbits[orbits[at]])
            trials = [k for k, orbit in enumerate(self.orbits) if len(orbit) == size and k not in orbits]
            scores = [self._score([*orbits[:at], k, *orbits[at + 1 :]]) for k in trials]
            best = int(np.argmin(scores)) if trials else -1
            if trials and scores[best] < score * (1 - 1e-9):
                orbits, score, kept = [*orbits[:at], trials[best], *orbits[at + 1 :]], scores[best], 0
            kept, at = kept + 1, (at + 1) % len(orbits)
        return score, np.concatenate([self.orbits[k] for k in orbits])


def check_count(count: int, domain: Domain) -> None:
    """Raise GeometryError if so many electrodes cannot be placed on a sheet: fewer than four, or fewer sites."""
    most = len(_sites(domain)[0]) // 2
    if not _LEAST_ON_RIM <= count <= most:
        raise GeometryError(f"{count} electrodes to place; between {_LEAST_ON_RIM} and {most}")


def _shares(count: int, sizes: set[int]) -> Iterator[tuple[tuple[int, int], ...]]:
    """How many orbits of each size may make up `count` electrodes."""
    ones = count % 2
    if 4 in sizes:
        yield from (((4, (count - ones - 2 * t) // 4), (2, t), (1, ones)) for t in range((count - ones) // 2 % 2, 8, 2))
    else:
        yield ((1, count),)


def _sites(domain: Domain) -> tuple[Floats, np.ndarray]:
    """Where electrodes may be (n, 2), mirror images included, and which of these (n,) are on the rim."""
    x0, y0, x1, y1 = domain.bounds
    pitch = min(x1 - x0, y1 - y0) / _STEPS
    if isinstance(domain, Disc):
        steps = range(1, _STEPS // 2 + 1)
        rings = [(0.0, 1)] + [(domain.radius * 2 * k / _STEPS, 4 * round(np.pi * k / 2)) for k in steps]
        angles = [(radius, 2 * np.pi * np.arange(count) / count) for radius, count in rings]
        sites = np.vstack([np.column_stack([r * np.cos(angle), r * np.sin(angle)]) for r, angle in angles])
    else:
        x, y = (np.linspace(a, b, 2 * round((b - a) / pitch / 2) + 1) for a, b in ((x0, x1), (y0, y1)))
        sites = np.stack(np.meshgrid(x[:-1] if domain.period else x, y), axis=-1).reshape(-1, 2)
        if not isinstance(domain, Rectangle | Band):
            inner = sites[domain.depth(sites) > pitch / 2]
            sites = np.vstack([*(_along(loop, pitch) for loop in (domain, *domain.holes)), inner])
    return sites, _on_rim(domain, sites)


def _on_rim(domain: Domain, points: Floats) -> NDArray[np.bool_]:
    """Which of points (n, 2) are on the rim, of a sleeve at one of its ends, not on that of a hole."""
    holes = [hole for hole in domain.holes if not isinstance(hole, Edge)]
    off = (np.abs(hole.depth(points)) > _AT for hole in holes)
    return np.asarray(np.logical_and.reduce([np.abs(domain.depth(points)) < _AT, *off]))


def _along(loop: Domain, pitch: float) -> Floats:
    """The corners of a rim (n, 2), and places between them, about so far apart (m)."""
    corners = loop.corners if len(loop.corners) else np.zeros(1)
    knots = np.append(corners, corners[0] + loop.perimeter)
    sides = (np.linspace(a, b, max(1, round((b - a) / pitch)), endpoint=False) for a, b in pairwise(knots))
    return loop.rim(np.concatenate(list(sides)))


def _mirrors(domain: Domain, sites: Floats, scale: Callable[[Floats], Floats]) -> list[Floats]:
    """The signs (2,) about the middle with which the skin is its own mirror image: all four, or the first alone."""
    kept = []
    for signs in product((1.0, -1.0), repeat=2):
        image = _image(domain, sites, np.array(signs))
        gaps = np.linalg.norm(shortest(image[:, None] - sites, domain.period), axis=2).min(axis=1)
        if gaps.max() < 1e-6 and np.abs(scale(image) / scale(sites) - 1).max() < _ALIKE:
            kept.append(np.array(signs))
    return kept if len(kept) == 4 else kept[:1]


def _image(domain: Domain, places: Floats, signs: Floats) -> Floats:
    """The mirror images (n, 2) of places about the middle."""
    x0, y0, x1, y1 = domain.bounds
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    return folded(middle + (places - middle) * signs, domain.period)


def _orbits(domain: Domain, sites: Floats, mirrors: list[Floats]) -> list[Ints]:
    """The sites that are mirror images of each other, by their numbers."""
    images = [
        np.linalg.norm(shortest(_image(domain, sites, signs) - sites[:, None], domain.period), axis=2).argmin(axis=0)
        for signs in mirrors
    ]
    found = {tuple(sorted({int(image[k]) for image in images})) for k in range(len(sites))}
    return [np.array(orbit, np.int64) for orbit in sorted(found)]


def _places(domain: Domain, radius: float, mirrors: list[Floats]) -> Floats:
    """Places of contacts (n, 2), wholly on the sheet, of mirror images one."""
    x0, y0, x1, y1 = domain.bounds
    half = len(mirrors) > 1
    axes = [
        np.linspace(a + radius, (a + b) / 2 if half else b - radius, _PLACES if half else 2 * _PLACES - 1)
        for a, b in ((x0, x1), (y0, y1))
    ]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    places = places[domain.depth(places) > radius * (1 - 1e-9)]
    return np.asarray(places[:: -(-len(places) // _MOST)])


def _mean_products(model: TransferModel, places: Floats, radius: float) -> Floats:
    """Minus the mean of grad u_a . grad u_b over contacts, and its derivatives (n_sites, n_sites, n_places, 4).

    Derivatives are by x, y (per m), and by the logarithm of the radius; in the order x, y, value, radius.
    """
    mesh, step = model.mesh, _SHIFT * radius
    density = np.einsum("ekd,ekl->led", model.shorted.gradients, model.potentials[mesh.elements])
    density *= np.sqrt(model.conductivity)[:, None]
    parts = []
    shifts = (0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (0, 0), (0, 0)
    for offset, r in zip(shifts, (1.0, 1.0, 1.0, 1.0, 1.0, 1.1, 0.9), strict=True):
        cover = disc_overlap(mesh, places + step * np.array(offset), r * radius)
        parts.append(cover.multiply(1 / cover.sum(axis=1)[:, None]).tocsr())
    middle, right, left, up, down, wide, narrow = parts
    kinds = ((right - left) / (2 * step), (up - down) / (2 * step), middle, (wide - narrow) / np.log(1.1 / 0.9))
    products = np.empty((len(density), len(density), len(places), 4))
    for a, field in enumerate(density):
        both = np.einsum("ed,bed->eb", field, density[: a + 1])
        for k, kind in enumerate(kinds):
            products[a, : a + 1, :, k] = products[: a + 1, a, :, k] = -(kind @ both).T
    return products
