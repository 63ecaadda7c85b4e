"""One-step Gauss-Newton in EIDORS' own terms: its hyperparameter, priors, reconstruction matrix and noise figure.

``inv_solve_diff_GN_one_step`` gives, with the sensitivity J to conductivity (not to its relative change) and a prior's
matrix R, the reconstruction matrix (J^T J + h^2 R)^-1 J^T. A `GaussNewton` with the same penalty makes the same images;
here it is made from h, and has its matrix and noise figure. To set noise and amplitude of one instead, see there.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh
from ohmskin.inverse.gauss_newton import GaussNewton
from ohmskin.inverse.modes import check_positive
from ohmskin.inverse.priors import Penalty, graph_laplacian
from ohmskin.scan import Difference, DrivePattern

EIDORS_PRIORS = "noser", "tikhonov", "laplace"
"""Names of EIDORS' priors: ``prior_noser``, ``prior_tikhonov``, ``prior_laplace``."""


@dataclass(frozen=True, eq=False)
class ReconstructionMatrix:
    """A linear reconstruction of one pattern's data.

    Args:
        estimator: An estimator that makes the same images of differences; its values are relative to the model's
            conductivity.
        matrix: (n_elem, n_meas) from voltages, or from normalised ones if `normalised`, to the change of conductivity
            (S per V, or S).
        normalised: Whether data are normalised.
    """

    estimator: GaussNewton
    matrix: Floats
    normalised: bool = False

    def reconstruct(self, difference: Difference) -> Floats:
        """Change of conductivity (n_elem,) (S) of a `difference`."""
        return np.asarray(self.matrix @ (difference.normalised if self.normalised else difference).volts)

    def noise_figure(self, signal: ArrayLike) -> float:
        """Signal-to-noise ratio of data over that of their image (EIDORS' ``calc_noise_figure`` of linear solvers).

        Signals are mean magnitudes; noise is independent and the same on all data. Its size in an image is the standard
        deviation over the elements, weighted by their size, in the mean over the data.

        Args:
            signal: (n_meas,) change of the data by a small target, such as one in the middle; normalised where the
                matrix is.

        Raises:
            ModelError: If it has another number of data.
        """
        told, sizes = np.asarray(signal, float), self.estimator.model.mesh.measures
        if told.shape != self.matrix.shape[1:]:
            raise ModelError(f"a signal of shape {told.shape}; the matrix takes ({self.matrix.shape[1]},) data")
        weighed = sizes[:, None] * self.matrix
        noise = np.std(weighed, axis=0, ddof=1).mean() * np.sqrt(len(told))
        return float(np.abs(told).mean() * noise / np.abs(weighed @ told).mean())


def eidors_one_step(
    model: TransferModel,
    pattern: DrivePattern,
    hyperparameter: float,
    prior: str = "noser",
    currents: ArrayLike = 1.0,
    exponent: float = 0.5,
    normalised: bool = False,
) -> ReconstructionMatrix:
    """The matrix of EIDORS' one-step Gauss-Newton solver for a model, a pattern and a hyperparameter.

    Args:
        model: The untouched skin, of one conductivity everywhere for the prior ``laplace``.
        pattern: What is driven and measured.
        hyperparameter: ``imdl.hyperparameter.value``.
        prior: One of `EIDORS_PRIORS`.
        currents: Injected, one value or (n_inj,) (A).
        exponent: Of ``prior_noser``.
        normalised: As ``fwd_model.normalize_measurements``.

    Raises:
        ModelError: If the hyperparameter is not positive, the prior unknown, or it does not fit the model.
    """
    check_positive(hyperparameter=hyperparameter)
    scale = np.ones(pattern.n_meas) / (model.voltages(pattern, currents) if normalised else 1.0)
    jacobian = scale[:, None] * model.sensitivity(pattern, currents)
    matrix = _penalty(model, jacobian, prior, exponent)
    relative = sp.diags_array(model.conductivity)
    penalty = Penalty(
        sp.csc_array(relative @ matrix @ relative), mean_variance=1.0, free_mean=prior == "laplace",
        places=model.mesh.centroids,
    )  # fmt: skip

    def belief(mesh: Mesh) -> Penalty:
        return penalty

    estimator = GaussNewton(model, hyperparameter, belief)
    amperes = scale * np.broadcast_to(np.asarray(currents, float), pattern.n_inj)[pattern.measurements[:, 0]]
    columns = [estimator.reconstruct(Difference(pattern, amperes, unit)).values for unit in np.eye(pattern.n_meas)]
    return ReconstructionMatrix(estimator, model.conductivity[:, None] * np.column_stack(columns), normalised)


def _penalty(model: TransferModel, jacobian: Floats, prior: str, exponent: float) -> sp.csc_array:
    """EIDORS' matrix R (n_elem, n_elem) of a prior."""
    if prior == "tikhonov":
        return sp.csc_array(sp.eye_array(model.mesh.n_elem))
    if prior == "noser":
        diagonal = np.einsum("me,me->e", jacobian, jacobian) ** exponent
        if not diagonal.min() > 0:
            raise ModelError(f"no datum depends on element {int(diagonal.argmin())}; prior_noser needs one for each")
        return sp.csc_array(sp.diags_array(diagonal))
    if prior == "laplace":
        if np.ptp(model.conductivity) > 1e-12 * model.conductivity.max():
            raise ModelError("prior_laplace is for a skin of one conductivity; use GaussNewton(prior='laplacian') else")
        return graph_laplacian(model.mesh).matrix
    raise ModelError(f"prior {prior!r} is not one of EIDORS' priors; choose from {', '.join(EIDORS_PRIORS)}")
