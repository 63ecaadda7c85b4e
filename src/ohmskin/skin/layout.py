"""Where the electrodes of a skin are, as its description says."""

import math
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.drive import arranged
from ohmskin.errors import GeometryError, SkinError
from ohmskin.geometry import Band, Chart, Domain, Electrodes, Rectangle, periodic
from ohmskin.geometry.band import Edge
from ohmskin.geometry.holes import without_holes
from ohmskin.geometry.spread import spread
from ohmskin.skin.checks import choice, number, places


@dataclass(frozen=True)
class ElectrodeLayout:
    """Where the electrodes are and of what kind.

    ``grid``: columns x rows with an inset; ``rim``: `count` round the rim; ``listed``: at `positions` [x, y] in
    metres, which are then numbered counterclockwise, those on the rim first; ``even``: `count` as far from each other
    as can be, on a sheet of any shape.
    On the rim the first is at the share `start` of its length, counterclockwise from where it starts: 0.25 is 12
    o'clock of a disc.
    """

    layout: str = choice("grid", "grid", "rim", "even", "listed")
    columns: int = number(4, 2, 32)
    rows: int = number(4, 2, 32)
    inset: float = number(0.0, 0, 10, "m")
    count: int = number(16, 4, 256)
    start: float = number(0.0, 0, 0.999999)
    clockwise: bool = False
    radius: float = number(3e-3, 1e-5, 1, "m")
    contact_resistivity: float = number(1e-4, 1e-9, 1e3, "ohm m2")
    positions: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", places(self.positions))

    @property
    def contact_impedance(self) -> float:
        """Of each electrode (ohm)."""
        return self.contact_resistivity / (math.pi * self.radius**2)

    def moved_to(self, positions: Floats) -> "ElectrodeLayout":
        """Such electrodes, listed at positions (n_elec, 2) of the map (m)."""
        listed = places(positions.tolist())
        return ElectrodeLayout(
            "listed", radius=self.radius, contact_resistivity=self.contact_resistivity, positions=listed
        )

    def on(self, chart: Chart) -> Electrodes:
        """The electrodes on the map of a sheet that `check` has passed."""
        domain = chart.domain
        if self.layout == "even":
            return arranged(domain, spread(domain, self.count, chart.scale))
        if self.layout == "listed":
            return arranged(domain, np.array(self.positions, float))
        if isinstance(shape := without_holes(domain), Rectangle | Band) and self.layout == "grid":
            return Electrodes.grid(shape, self.columns, self.rows, self.inset)
        return Electrodes.rim(domain, self.count, self.start, self.clockwise)

    def check(self, chart: Chart) -> None:
        """Raise SkinError if the layout does not fit the sheet, or positions are given that it does not take."""
        domain = chart.domain
        listed, grid = self.layout == "listed", self.layout == "grid"
        if grid and not isinstance(without_holes(domain), Rectangle | Band):
            told = 'electrode.layout is "grid", which needs a rectangle or a sleeve'
            raise SkinError(f'{told}; use "rim", "even" or "listed"')
        if self.positions and not listed:
            told = f'electrode.positions are given but the layout is "{self.layout}"'
            raise SkinError(f'{told}; use layout = "listed"')
        if listed and len(self.positions) < 4:
            raise SkinError(f"electrode.positions lists {len(self.positions)} electrodes; need at least 4")
        if listed:
            _check_holes(domain, np.array(self.positions, float), "electrode.positions[{}] is {}")
            depth = periodic.depth(domain, np.array(self.positions, float))
            if (depth < -1e-6).any():
                k = int(np.argmin(depth))
                off = f"electrode.positions[{k}] is {list(self.positions[k])}, {-depth[k]:.3g} m off the sheet"
                raise SkinError(f"{off}; move it onto it")
        if self.layout == "even":  # which takes a while to place
            return
        try:
            positions = self.on(chart).positions
        except GeometryError as error:
            raise SkinError(f"electrode{'.positions' if listed else ''}: {error}") from None
        if grid:
            _check_holes(domain, positions, "electrode {} of the grid is at {}")


def _check_holes(domain: Domain, positions: Floats, what: str) -> None:
    """Raise SkinError if one of positions (n, 2) lies in a hole; it is `what` by number and place."""
    for hole in domain.holes:
        depth = np.full(len(positions), -1.0) if isinstance(hole, Edge) else hole.depth(positions)
        if depth.max(initial=-1.0) > 1e-6:
            k = int(np.argmax(depth))
            place = [round(value, 6) for value in positions[k].tolist()]
            inside = f"{what.format(k, place)}, {depth[k]:.3g} m inside a hole"
            raise SkinError(f'{inside}; move it or the hole, or use electrode.layout = "even", which avoids holes')
