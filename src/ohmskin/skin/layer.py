"""The contact layer: patches on foam that short the sheet where they are pressed on it, and what foam remembers."""

from dataclasses import dataclass
from math import exp, log, log1p

import numpy as np

from ohmskin.errors import SkinError
from ohmskin.geometry import Chart
from ohmskin.skin.checks import number
from ohmskin.skin.patches import COVERED, PatchLayout, rings, rows

_STRETCH = 0.6  # of the logarithm of pressure, in which hysteresis has turned to 1/e; above its largest gap
_NEWTON, _SMALL, _LEAST_SLOPE = 8, 1e-6, 0.05


@dataclass(frozen=True)
class ContactLayer:
    """Floating conductive patches on foam that short the sheet where they are pressed on it.

    There are `columns` x `rows` of them, of equal size on the skin's map. If these are 0, there are as many as leave
    gaps of a tenth, with sides of `patch` on the skin: in rows where the scale of its map changes in one direction
    only, as on a cone, and in rings about the middle where it changes only with the distance from there, as on a
        cap. On all other maps they have equal size on the map, and that size on the skin on average. The conductance
        per area between patch and sheet is ``conductance * (pressure / pressure_scale) ** exponent``. Foam has
        hysteresis and creep: while a press falls, the acting pressure exceeds the applied pressure by up to
        `hysteresis`; under a lasting press the acting pressure grows by `creep`, with the time constant
            `creep_time`. Outside an indenter's edge pressure falls to 0 within `foam_spread`.

    Args:
        columns, rows: Number of patches along x and y, 0 to 256.
        patch: Side of a patch (m).
        conductance: Per area at the pressure scale (S/m2).
        pressure_scale: Pressure at which the conductance has that value (Pa).
        exponent: Of its growth with pressure (1), 0.1 to 3.
        foam_spread: Width of the ring round a press in which its pressure falls to 0 (m).
        hysteresis: Share by which the acting pressure exceeds the applied one while a press falls (1), 0 to 0.5.
        creep: Share by which the acting pressure grows under a lasting press (1), 0 to 1.
        creep_time: Time constant of that (s).
    """

    columns: int = number(0, 0, 256)
    rows: int = number(0, 0, 256)
    patch: float = number(7.5e-3, 1e-5, 1, "m")
    conductance: float = number(3.66e3, 1e-6, 1e9, "S/m2")
    pressure_scale: float = number(20e3, 1, 1e9, "Pa")
    exponent: float = number(0.95, 0.1, 3)
    foam_spread: float = number(2e-3, 0, 1, "m")
    hysteresis: float = number(0.0, 0, 0.5)
    creep: float = number(0.0, 0, 1)
    creep_time: float = number(10.0, 1e-3, 1e5, "s")

    def number_on(self, chart: Chart) -> int:
        """Approximate number of patches on a map, including those off the sheet.

        Args:
            chart: The map of the skin.
        """
        return int(np.prod(self._counts(chart)))

    def patches(self, chart: Chart) -> PatchLayout:
        """The patches on a map; some may be off the sheet.

        Args:
            chart: The map of the skin.

        Raises:
            SkinError: If patches would overlap.
        """
        if chart.flat or self.columns or self.rows:
            return self._regular(chart)
        return rows(chart, self.patch) or rings(chart, self.patch) or self._regular(chart)

    def _regular(self, chart: Chart) -> PatchLayout:
        """Patches in columns and rows, equal on the map."""
        (columns, rows), (x0, y0, x1, y1) = self._counts(chart), chart.domain.bounds
        if min((x1 - x0) / columns, (y1 - y0) / rows) < self.patch * (1 - 1e-9) and columns * rows > 1:
            over = f"{columns} x {rows} patches of {self.patch:.4g} m overlap on {x1 - x0:.4g} x {y1 - y0:.4g} m"
            raise SkinError(f"{over}; lower contact_layer.columns, rows or patch, or leave columns and rows out")
        x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
        y = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
        middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return PatchLayout(middles, np.full(middles.shape, self.patch))

    def _counts(self, chart: Chart) -> tuple[int, int]:
        """Columns and rows of patches that are equal on the map."""
        x0, y0, x1, y1 = chart.domain.bounds
        columns, rows = (max(1, round(COVERED * length / self.patch)) for length in (x1 - x0, y1 - y0))
        return self.columns or columns, self.rows or rows

    @property
    def remembers(self) -> bool:
        """Whether the acting pressure depends on earlier presses."""
        return bool(self.hysteresis or self.creep)

    def acting(self, before: "Foam | None", pressure: float, elapsed: float) -> "Foam":
        """The foam under a press after a change of its pressure.

        Args:
            before: Its former state; None: the press begins.
            pressure: Present pressure of the press, above 0 (Pa).
            elapsed: Time since `before` (s).
        """
        if before is None:
            return Foam(pressure, pressure, 0.0, 0.0)
        gap = self._gap(before.gap, log(pressure / before.pressure))
        crept = self._crept(before, elapsed)
        return Foam(pressure, pressure * exp(gap) + self.creep * crept, gap, crept)

    def pressing(self, before: "Foam | None", acting: float, elapsed: float) -> "Foam":
        """The foam under a press whose acting pressure is known; the inverse of `acting`.

        Args:
            before, elapsed: As for `acting`.
            acting: Pressure that acts on the sheet, above 0 (Pa).
        """
        if before is None:
            return Foam(acting, acting, 0.0, 0.0)
        crept = self._crept(before, elapsed)
        wanted = log(max(acting - self.creep * crept, 1e-3 * acting) / before.pressure) - before.gap
        step = wanted
        for _ in range(_NEWTON):
            slope = 1 + (self._gap(before.gap, step + _SMALL) - self._gap(before.gap, step)) / _SMALL
            step -= (step + self._gap(before.gap, step) - before.gap - wanted) / max(slope, _LEAST_SLOPE)
        pressure = before.pressure * exp(step)
        return Foam(pressure, acting, self._gap(before.gap, step), crept)

    @staticmethod
    def turned(share: float) -> float:
        """Share of the foam's hysteresis at a press that has fallen to a share of its greatest pressure (1)."""
        return float(1 - share ** (1 / _STRETCH))

    def _gap(self, gap: float, step: float) -> float:
        """By how much more acts than presses (1, logarithmic) after the logarithm of the pressure went up by a step.

        It follows the way the pressure goes within a stretch of it, as Dahl's friction does (Aerospace Corp. report
        TOR-0158(3107-18)-1, 1968).
        """
        goal = 0.0 if step > 0 else log1p(self.hysteresis)
        return goal + (gap - goal) * exp(-abs(step) / _STRETCH)

    def _crept(self, before: "Foam", elapsed: float) -> float:
        """What the foam has yielded to after a time (Pa)."""
        goal = before.pressure * exp(before.gap)
        return goal + (before.crept - goal) * exp(-max(elapsed, 0.0) / self.creep_time)


@dataclass(frozen=True)
class Foam:
    """The foam under one press.

    Args:
        pressure: Applied pressure (Pa).
        acting: Acting pressure on the sheet (Pa).
        gap: Logarithm of the factor on it due to hysteresis (1).
        crept: Pressure to which the foam has crept (Pa).
    """

    pressure: float
    acting: float
    gap: float
    crept: float
