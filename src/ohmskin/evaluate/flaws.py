"""What an estimator believes of a sheet, and what may be wrong with that."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.worlds import LAYOUTS
from ohmskin.forward import TransferModel
from ohmskin.forward.conductivity import cosines
from ohmskin.geometry import Domain, Electrodes, mesh_domain
from ohmskin.skin import Skin

_BUMP = 30e-3  # m, width of the bumps of an uneven sheet


@dataclass(frozen=True)
class Flaw:
    """Errors of the model, or changes of the skin since its calibration.

    Args:
        wear: Contact impedance of the electrodes over the usual one, when the skin is calibrated.
        since: Factor by which it has grown since, which the reference does not include.
        misplaced: Distance between the true and the assumed place of an electrode (m); in a random direction, on the
            rim along it.
        uneven: Standard deviation of the believed conductivity, as a share; smooth, of bumps of some 30 mm.
        calibrated: Whether places of electrodes and conductivity are then fitted to quiet voltages, see `fit_sheet`.
        draw: Which random directions and bumps.
    """

    wear: float = 1.0
    since: float = 1.0
    misplaced: float = 0.0
    uneven: float = 0.0
    calibrated: bool = False
    draw: int = 0


SOUND = Flaw()


Build = Callable[[Electrodes, Floats], TransferModel]


def assumed_model(layout: str = "grid", flaw: Flaw = SOUND) -> tuple[Electrodes, Build]:
    """Where the electrodes are believed to be, and what makes models of the untouched sheet as it is believed to be.

    They have electrodes where they are placed, and a factor on the conductivity as `fit_sheet` takes it.
    """
    skin, random = Skin.load(LAYOUTS[layout]), np.random.default_rng([flaw.draw, 7])
    placed = misplaced(skin, flaw.misplaced, random) if flaw.misplaced else skin.electrodes
    uneven = Bumps(skin.domain, random) if flaw.uneven else None

    def build(electrodes: Electrodes, log_conductivity: Floats) -> TransferModel:
        mesh = skin.mesh_for(electrodes)
        even = skin.sheet.conductivity * np.exp(cosines(mesh.centroids, skin.domain, log_conductivity))
        return TransferModel(mesh, electrodes, even * (1 + flaw.uneven * uneven(mesh.centroids)) if uneven else even)

    return placed, build


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


class Bumps:
    """A smooth random field of mean zero and standard deviation one over a sheet."""

    def __init__(self, domain: Domain, random: np.random.Generator) -> None:
        x0, y0, x1, y1 = domain.bounds
        count = max(4, round(4 * (x1 - x0 + 2 * _BUMP) * (y1 - y0 + 2 * _BUMP) / (np.pi * _BUMP**2)))
        self._places = random.uniform((x0 - _BUMP, y0 - _BUMP), (x1 + _BUMP, y1 + _BUMP), (count, 2))
        self._heights = random.standard_normal(count)
        self._mean, self._std = 0.0, 1.0
        mesh = mesh_domain(domain, (x1 - x0) / 50)
        values = self(mesh.centroids)
        self._mean = float(np.average(values, weights=mesh.measures))
        self._std = float(np.sqrt(np.average((values - self._mean) ** 2, weights=mesh.measures)))

    def __call__(self, points: Floats) -> Floats:
        """Values (n,) at points (n, 2) (m)."""
        squares = ((points[:, None] - self._places) ** 2).sum(axis=-1)
        return np.asarray((np.exp(-squares / (2 * _BUMP**2)) @ self._heights - self._mean) / self._std)
