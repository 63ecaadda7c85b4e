"""Your own drive, estimator and prior: in the loop, on the page and in the skin file by their names.

python docs/guide/extend.py
"""

import numpy as np
import scipy.sparse as sp

import ohmskin as ohm
from ohmskin.drive import DRIVES, Drive, DriveSettings, Fixed
from ohmskin.forward import TransferModel
from ohmskin.inverse import ESTIMATORS, PRIORS, Estimator, EstimatorSettings, FrameWise, Prior
from ohmskin.scan import all_pairs, measure_others


def diagonals(s: DriveSettings, injections: int) -> Drive:
    """The longest pairs of electrodes, measured at all others."""
    pairs = all_pairs(len(s.electrodes))
    length = np.linalg.norm(np.diff(s.electrodes.positions[pairs], axis=1)[:, 0], axis=1)
    longest = pairs[np.argsort(-length, kind="stable")[: injections or s.pairs]]
    return Fixed(measure_others(longest, range(len(s.electrodes))))


class BackProjection:
    """Filtered back-projection in its simplest form: data smeared back along their sensitivities."""

    def __init__(self, model: TransferModel) -> None:
        self._relative = model.pair_sensitivity * model.conductivity  # (n_pairs, n_elem)
        self._n_elec = len(model.electrodes)

    def reconstruct(self, *differences: ohm.Difference) -> ohm.Image:
        """The image of one scan, or of several fused."""
        rows = [d.combination(self._n_elec) @ self._relative * d.currents[:, None] for d in differences]
        sensitivity, volts = np.vstack(rows), np.concatenate([d.volts for d in differences])
        known = np.isfinite(volts)
        power = np.einsum("me,me->e", sensitivity[known], sensitivity[known])
        weights = sensitivity[known].T / (power + 0.1 * power.max())[:, None]  # a place of low sensitivity must not win
        noise = float(np.std(volts[known]))
        return ohm.Image(weights @ volts[known], lambda e: noise * np.linalg.norm(weights[np.atleast_1d(e)], axis=1))


def back_projection(s: EstimatorSettings) -> Estimator:
    """Back-projection."""
    return FrameWise(BackProjection(s.model), s.model.mesh)


def bumps(model: TransferModel) -> Prior:
    """Neighbours of neighbours are alike."""
    return lambda mesh: sp.csc_array(
        (laplacian := 4 * sp.eye_array(mesh.n_elem) - mesh.adjacency) @ laplacian  # positive definite: 4 beats 3
    )


# in a package of your own: an entry point of the group ohmskin.drives, ohmskin.estimators or ohmskin.priors instead
DRIVES.add("diagonals", diagonals)
ESTIMATORS.add("back-projection", back_projection)
PRIORS.add("bumps", bumps)

skin = ohm.Skin.parse("""
name = "mine"
[modes.mine]
title = "Long pairs"
drive = "diagonals"
reader = "centroid"
estimator = "back-projection"

[modes.mine-too]
drive = "diagonals"
reader = "fit"
prior = "bumps"
""")
for mode in ("mine", "mine-too"):
    with ohm.Engine(lambda: ohm.connect("virtual:", skin=skin, seed=1), skin, mode) as engine:
        engine.calibrate()
        engine.press(1, at=(0.05, 0.12), radius=8e-3, pressure=20e3)
        touches = engine.touches()
        touch = [next(touches) for _ in range(8)][-1]
        x, y = touch.contacts[0].position
        print(f"{mode}: felt at ({1e3 * x:.0f}, {1e3 * y:.0f}) mm, pressed at (50, 120) mm")
