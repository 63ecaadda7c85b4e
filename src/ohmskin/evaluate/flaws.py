"""What an estimator believes of a sheet, and what may be wrong with that."""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.worlds import LAYOUTS
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes, Mesh, mesh_domain
from ohmskin.skin import Skin

_WAVES = 4  # half waves along a side of the sheet, up to which the believed conductivity is wavy


@dataclass(frozen=True)
class Flaw:
    """What is wrong with the model, or with the skin since its calibration.

    Args:
        wear: Contact impedance of the electrodes over the usual one.
        since: Whether it grew after the calibration, so that the reference does not know it.
        misplaced: Distance between where an electrode is and where it is believed to be (m); in a random direction, on
            the rim along it.
        uneven: Standard deviation of the believed conductivity, as a share; smooth, with half waves of 50 mm and
            longer.
        draw: Which random directions and waves.
    """

    wear: float = 1.0
    since: bool = False
    misplaced: float = 0.0
    uneven: float = 0.0
    draw: int = 0


SOUND = Flaw()


def believed(layout: str = "grid", flaw: Flaw = SOUND) -> TransferModel:
    """The estimator's model of the untouched sheet, with the electrodes where they are believed to be."""
    skin, random = Skin.load(LAYOUTS[layout]), np.random.default_rng([flaw.draw, 7])
    electrodes = misplaced(skin, flaw.misplaced, random) if flaw.misplaced else skin.electrodes
    mesh = mesh_domain(skin.domain, skin.imaging.mesh_size, electrodes.positions)
    return TransferModel(mesh, electrodes, skin.sheet.conductivity * (1 + flaw.uneven * waves(mesh, random)))


def misplaced(skin: Skin, distance: float, random: np.random.Generator) -> Electrodes:
    """The electrodes of a rectangular skin, each moved by a distance (m): inner ones anywhere, others along the rim."""
    true = skin.electrodes
    angle = random.uniform(0, 2 * np.pi, len(true))
    moves = distance * np.column_stack([np.cos(angle), np.sin(angle)])
    high = np.array([skin.sheet.width, skin.sheet.height])
    on_side = (true.positions < 1e-9) | (true.positions > high - 1e-9)  # (n_elec, 2)
    along = np.where(on_side[:, :1], [0.0, 1.0], [1.0, 0.0]) * distance * np.sign(moves[:, :1])
    moved = true.positions + np.where(on_side.any(axis=1, keepdims=True), along, moves)
    outside = (moved < 0) | (moved > high)  # a corner moves along whichever of its sides is there
    moved = np.where(outside, 2 * true.positions - moved, moved)
    return true.mapped(lambda _: moved)


def waves(mesh: Mesh, random: np.random.Generator) -> Floats:
    """A smooth random field (n_elem,) of mean zero and standard deviation one over the sheet."""
    at = (mesh.centroids - mesh.nodes.min(axis=0)) / np.ptp(mesh.nodes, axis=0)
    kx, ky = np.meshgrid(np.arange(_WAVES + 1), np.arange(_WAVES + 1))
    terms = np.cos(np.pi * np.outer(at[:, 0], kx.ravel())) * np.cos(np.pi * np.outer(at[:, 1], ky.ravel()))
    field = terms @ random.standard_normal(kx.size)
    field -= np.average(field, weights=mesh.measures)
    unit: Floats = field / np.sqrt(np.average(field**2, weights=mesh.measures))
    return unit
