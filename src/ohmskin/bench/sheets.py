"""What the benchmark works on: the paper's square sheet with regular meshes, the same for all programs."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh, Rectangle
from ohmskin.scan import DrivePattern

Scanned = tuple[Floats, Floats]  # change of the voltages (n_meas,), currents (n_inj,)

SIDE = 0.2  # m
CONDUCTIVITY = 1.83e-3  # S


def grid(cells: int) -> tuple[Floats, Ints]:
    """Nodes and triangles (2 cells^2, 3) of the sheet, cut into squares and these into two."""
    axis = np.linspace(0.0, SIDE, cells + 1)
    x, y = np.meshgrid(axis, axis)
    corner = (np.arange(cells) + (cells + 1) * np.arange(cells)[:, None]).ravel()
    across, up = corner + 1, corner + cells + 1
    triangles = np.concatenate([np.column_stack([corner, across, up + 1]), np.column_stack([corner, up + 1, up])])
    return np.column_stack([x.ravel(), y.ravel()]), triangles


def mesh(cells: int) -> Mesh:
    """The mesh; `cells` must be a multiple of one less than the electrodes along a side."""
    return Mesh(*grid(cells))


def electrodes(along: int = 4) -> Electrodes:
    """A grid of `along` x `along` point electrodes that spans the sheet."""
    return Electrodes.grid(Rectangle(SIDE, SIDE), along, along)


def square(cells: int, column: int, row: int, size: int) -> Ints:
    """The elements (2 size^2,) of `grid(cells)` in a square of size x size cells."""
    lower = ((row + np.arange(size))[:, None] * cells + column + np.arange(size)).ravel()
    return np.concatenate([lower, lower + cells * cells])


def touched(model: TransferModel, *places: ArrayLike) -> Callable[[DrivePattern], Scanned]:
    """Scans at 1 mA of a sheet that conducts half as well again within 10 mm of each place (m)."""
    conductivity = model.conductivity.copy()
    for place in places:
        conductivity[np.linalg.norm(model.mesh.centroids - np.asarray(place), axis=1) < 0.01] *= 1.5
    pressed = model.with_conductivity(conductivity)

    def scan(pattern: DrivePattern) -> Scanned:
        return pressed.voltages(pattern, 1e-3) - model.voltages(pattern, 1e-3), np.full(pattern.n_inj, 1e-3)

    return scan
