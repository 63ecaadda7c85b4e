"""Where the patches of a contact layer are on the map of a skin: in columns and rows, or in rings about a pole."""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.geometry import Chart

COVERED = 0.9  # share of a layer's length that patches cover, unless described otherwise
_ALONG = 1.1  # by which the scale of a map may change along a row or ring of patches of one size
_FINE = 128  # places along each side of a map at which its scale is looked at


@dataclass(frozen=True)
class PatchLayout:
    """Patches on a map: rectangles along x and y, or sectors of rings about a centre.

    Args:
        middles: (n, 2) (m); some may be off the sheet.
        sides: (n, 2) along x and y, of sectors along the radius and along the middle of the ring (m).
        centre: (x, y) of the rings (m); None: they are rectangles.
    """

    middles: Floats
    sides: Floats
    centre: tuple[float, float] | None = None

    def divided(self, ends: Floats) -> tuple[Floats, Floats]:
        """The parts (n, k * k) into which lines across both sides divide every patch.

        Args:
            ends: (k + 1,) where they cross a side, from its middle, as shares of it.

        Returns:
            Middles (n, k * k, 2), and two sides of each part as rows (n, k * k, 2, 2) (m).
        """
        middle, side = (ends[1:] + ends[:-1]) / 2, np.diff(ends)
        offsets, sizes = (np.stack(np.meshgrid(one, one), axis=-1).reshape(-1, 2) for one in (middle, side))
        offsets, sizes = (self.sides[:, None] * one for one in (offsets, sizes))
        if self.centre is None:
            return self.middles[:, None] + offsets, sizes[..., None] * np.eye(2)
        away = self.middles - np.array(self.centre)
        radius = np.linalg.norm(away, axis=1)[:, None]
        angle = np.arctan2(away[:, 1], away[:, 0])[:, None] + offsets[..., 1] / radius
        outwards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        onwards = outwards[..., ::-1] * [-1.0, 1.0]
        distance = radius + offsets[..., 0]
        lengths = np.stack([sizes[..., 0], sizes[..., 1] * distance / radius], axis=-1)
        places = np.array(self.centre) + distance[..., None] * outwards
        return places, lengths[..., None] * np.stack([outwards, onwards], axis=-2)


def rows(chart: Chart, patch: float) -> PatchLayout | None:
    """Rows along x of patches that are as large as `patch` (m) on the skin, if the map's scale is even along each.

    Args:
        chart: The map.
        patch: Side of a patch (m).
    """
    x0, y0, x1, y1 = chart.domain.bounds
    x, y = (low + (high - low) * (np.arange(_FINE) + 0.5) / _FINE for low, high in ((x0, x1), (y0, y1)))
    scale, across = _along(chart, np.stack(np.meshgrid(x, y), axis=-1))
    if across is None:
        return None
    cells = [
        ((left + right) / 2, (low + high) / 2, right - left, high - low)
        for low, high in _divided(y0, y1, across, patch)
        for left, right in _divided(x0, x1, scale[np.argmin(np.abs(y - (low + high) / 2))], patch)
    ]
    middles, sides = np.split(np.array(cells), 2, axis=1)
    return PatchLayout(middles, COVERED * sides)


def rings(chart: Chart, patch: float) -> PatchLayout | None:
    """Rings about the map's middle of patches that are as large as `patch` (m) on the skin, if its scale is even along
    each.

    Args:
        chart: The map.
        patch: Side of a patch (m).
    """
    x0, y0, x1, y1 = chart.domain.bounds
    centre, reach = ((x0 + x1) / 2, (y0 + y1) / 2), max(x1 - x0, y1 - y0) / 2
    radius, angle = reach * (np.arange(_FINE) + 0.5) / _FINE, 2 * np.pi * np.arange(_FINE) / _FINE
    outwards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = None if chart.domain.period else _along(chart, np.array(centre) + radius[:, None, None] * outwards)[1]
    if across is None:
        return None
    middles, sides = list[Floats](), list[Floats]()
    for low, high in _divided(0.0, reach, across, patch):
        middle = (low + high) / 2
        around = 2 * np.pi * middle
        area = around * (high - low) * float(np.interp(middle, radius, across)) ** 2
        count = max(1, round(area * (COVERED / patch) ** 2))
        angle = 2 * np.pi * (np.arange(count) + 0.5) / count
        middles.append(np.array(centre) + middle * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
        sides.append(np.tile([high - low, around / count], (count, 1)))
    return PatchLayout(np.concatenate(middles), COVERED * np.concatenate(sides), centre)


def _along(chart: Chart, lines: Floats) -> tuple[Floats, Floats | None]:
    """A map's scale at places on n lines (n, m, 2): (n, m), and (n,) in the mean of each where it is on the sheet; None
    where it changes along one."""
    flat = lines.reshape(-1, 2)
    scale = chart.scale(flat).reshape(lines.shape[:2])
    inside = np.where(chart.domain.depth(flat).reshape(scale.shape) > 0, scale, np.nan)
    inside[np.isnan(inside).all(axis=1)] = scale.mean()
    uneven = (np.nanmax(inside, axis=1) > _ALONG * np.nanmin(inside, axis=1)).any()
    return scale, None if uneven else np.nanmean(inside, axis=1)


def _divided(low: float, high: float, scale: Floats, patch: float) -> Floats:
    """Ends (n, 2) of the parts of a length of the map that are as long on the skin as a patch and its gap.

    Args:
        low, high: Its ends (m).
        scale: (n,) metres on the skin for a metre on the map, at the middles of as many equal parts of it.
        patch: Side of a patch (m).
    """
    along = np.append(0.0, np.cumsum(scale)) * (high - low) / len(scale)
    count = max(1, round(COVERED * float(along[-1]) / patch))
    ends = np.interp(along[-1] * np.arange(count + 1) / count, along, np.linspace(low, high, len(along)))
    return np.stack([ends[:-1], ends[1:]], axis=1)
