"""What the benchmark works on: the paper's square sheet with regular meshes, the same for all programs."""

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.geometry import Electrodes, Mesh, Rectangle

SIDE = 0.2  # m
SHEET = Rectangle(SIDE, SIDE)
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
    return Electrodes.grid(SHEET, along, along)


def square(cells: int, column: int, row: int, size: int) -> Ints:
    """The elements (2 size^2,) of `grid(cells)` in a square of size x size cells."""
    lower = ((row + np.arange(size))[:, None] * cells + column + np.arange(size)).ravel()
    return np.concatenate([lower, lower + cells * cells])
