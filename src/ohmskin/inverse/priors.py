"""Priors: what is believed about an image before anything is measured.

A prior is a function from a mesh to the penalty of an image. The simplest penalty is a sparse symmetric positive
definite matrix R (n_elem, n_elem), the penalty of an image x being x^T R x. `Penalty` also takes images that hang on
other unknowns than one per triangle. Functions such as ``matern(0.03)`` return a prior with settings. What each of
them assumes is in docs/guide/priors.md.

Total variation and sparsity are not quadratic: they have estimators of their own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.forward import TransferModel
from ohmskin.forward.assembly import Solver, elimination, stiffness
from ohmskin.geometry import Mesh
from ohmskin.geometry.mesh import facet_measures
from ohmskin.registry import Registry
from ohmskin.scan import adjacent

FREE = 100.0
"""Standard deviation of a mean that is left free, where an estimator asks for one (relative to that of the image)."""


@dataclass(frozen=True)
class Penalty:
    """Penalty w^T matrix w of an image x = image w. The prior covariance of x is image matrix^-1 image^T.

    Args:
        matrix: (n_unknowns, n_unknowns) sparse, symmetric positive definite.
        image: (n_elem, n_unknowns) sparse, from the unknowns to the image; None where they are the same.
        mean_variance: Variance of the image, averaged over the sheet, to which the penalty is scaled; None: it is used
            as given, and scaled to one by its user.
        free_mean: Whether uniform images, the null space of `matrix`, have no penalty. Then the average variance does
            not include the mean. Only without `image`.
        places: (n_unknowns, dim) place of each unknown (m); makes factorising the matrix much faster.

    Raises:
        ModelError: If shapes do not fit, or the matrix is complex, not finite, not symmetric or, when it is first used,
            not positive definite (with a free mean: but for constants).
    """

    matrix: sp.csc_array
    image: sp.csr_array | None = None
    mean_variance: float | None = None
    free_mean: bool = False
    places: Floats | None = None

    def __post_init__(self) -> None:
        matrix, n = checked_matrix(self.matrix), self.matrix.shape[0]
        if self.image is not None and (self.free_mean or self.image.shape[1] != n):
            raise ModelError(
                f"a penalty of {n} unknowns, with image {self.image.shape}, free_mean {self.free_mean}; "
                "give an image (n_elem, n_unknowns), and leave the mean free only without one"
            )
        if self.free_mean and np.abs(matrix @ np.ones(n)).max() > 1e-9 * np.abs(matrix.data).max():
            raise ModelError("a prior with free_mean penalises constants; make each row of its matrix sum to zero")
        object.__setattr__(self, "matrix", matrix)

    @cached_property
    def normalised(self) -> sp.csc_array:
        """The matrix, scaled so that the variance of the image, averaged over the sheet, is one.

        A mean that is free has a standard deviation of `FREE`, so that the matrix is positive definite.
        """
        matrix, n = self.matrix * self.average_variance, self.matrix.shape[0]
        return sp.csc_array(matrix + sp.eye_array(n) / (n * FREE**2) if self.free_mean else matrix)

    @cached_property
    def _factor(self) -> Solver:
        n = self.matrix.shape[0]
        places = np.arange(n, dtype=float)[:, None] if self.places is None else self.places
        advice = "add to its diagonal, or leave constants free: Penalty(matrix, free_mean=True)"
        try:  # a mean that is free is taken off; what is left is known relative to the first unknown
            factor = elimination(self.matrix, places, 0 if self.free_mean else -1).factorise(self.matrix.data)
        except ModelError:
            raise ModelError(f"the prior's matrix is not positive definite; {advice}") from None
        probe = np.random.default_rng(0).choice([-1.0, 1.0], size=(n, 1))
        reach = float(np.abs(factor.solve(probe)).max() * np.abs(self.matrix.data).max())
        if not reach < 1e13:
            raise ModelError(f"the prior's matrix is singular to {1 / reach:.0e}; {advice}")
        return factor

    def whitened(self, columns: Floats) -> Floats:
        """W columns (n_white, n) of columns (n_elem, n), with W^T W the covariance, of average variance one.

        A free mean is not included; then there is one white unknown less.
        """
        given = self._centred(columns if self.image is None else self.image.T @ columns)
        return np.asarray(self._factor.half_solve(given) / np.sqrt(self.average_variance))

    def coloured(self, white: Floats) -> Floats:
        """The images W^T white (n_elem, n) of white unknowns (n_white, n), see `whitened`."""
        fields = self._factor.half_solve_transposed(white) / np.sqrt(self.average_variance)
        return self.to_image(self._centred(fields))

    def covariance(self, columns: Floats) -> Floats:
        """The prior covariance, scaled to an average variance of one, times `columns` (n_elem, n)."""
        return self._apply(columns) / self.average_variance

    def to_image(self, unknowns: Floats) -> Floats:
        """The image (n_elem, ...) of unknowns (n_unknowns, ...)."""
        return unknowns if self.image is None else self.image @ unknowns

    def to_unknowns(self, rows: Floats) -> Floats:
        """Rows (n, n_elem) that act on the image, as rows (n, n_unknowns) that act on the unknowns."""
        return rows if self.image is None else np.asarray(rows @ self.image)

    def _apply(self, columns: Floats) -> Floats:
        given = self._centred(columns if self.image is None else self.image.T @ columns)
        return self.to_image(self._centred(self._factor.solve(given)))

    def _centred(self, columns: Floats) -> Floats:
        return columns - columns.mean(axis=0) if self.free_mean else columns

    @cached_property
    def average_variance(self) -> float:
        """Variance of the image for the given matrix, averaged over the sheet; `mean_variance` if it is given."""
        if self.mean_variance is not None:
            return self.mean_variance
        n = self.matrix.shape[0] if self.image is None else self.image.shape[0]
        return mean_diagonal(self._apply, n)


def checked_matrix(given: "sp.sparray | ArrayLike") -> sp.csc_array:
    """A prior's matrix as sparse columns, checked.

    Raises:
        ModelError: If it is not square, real, finite and symmetric.
    """
    advice = "a prior gives a sparse symmetric positive definite matrix (n_elem, n_elem), or a Penalty"
    try:
        matrix = sp.csc_array(given)
    except (TypeError, ValueError):
        raise ModelError(f"a prior gave {type(given).__name__}; {advice}") from None
    if matrix.dtype.kind not in "fiub" or matrix.shape[0] != matrix.shape[1]:
        raise ModelError(f"a prior gave a matrix of shape {matrix.shape} and type {matrix.dtype}; {advice}")
    matrix = sp.csc_array(matrix, dtype=float)
    if not np.isfinite(matrix.data).all():
        raise ModelError(f"a prior gave a matrix with entries that are not finite; {advice}")
    skew = float(np.abs((matrix - matrix.T).data).max(initial=0.0) / np.abs(matrix.data).max(initial=1e-300))
    if skew > 1e-9:
        by = f"by {skew:.2g} of its largest entry; both triangles are needed"
        raise ModelError(f"a prior gave a matrix that is not symmetric ({by}); {advice}")
    return sp.csc_array((matrix + matrix.T) / 2)


def mean_diagonal(apply: Callable[[Floats], Floats], n: int, probes: int = 256) -> float:
    """Mean of the diagonal of a matrix (n, n) known by its products, from random signs (Hutchinson).

    About one per cent off, the same every time.
    """
    signs: Floats = np.random.default_rng(0).choice([-1.0, 1.0], size=(n, probes))
    return float(np.mean(signs * apply(signs)))


Prior = Callable[[Mesh], "sp.csc_array | Penalty"]
"""A prior: function from a mesh to its penalty, a matrix (n_elem, n_elem) or a `Penalty`."""


def paper_laplacian(mesh: Mesh) -> sp.csc_array:
    """Eq. (5) of the paper: d + 1 = 3 on the diagonal, -1 for triangles of a `mesh` that share an edge.

    Triangles at the rim have fewer neighbours but the same diagonal: definite, and the image is pulled to zero there.
    """
    return sp.csc_array((mesh.dim + 1) * sp.eye_array(mesh.n_elem) - mesh.adjacency)


def graph_laplacian(mesh: Mesh) -> Penalty:
    """Twice (degree - adjacency) of a `mesh`: what EIDORS calls ``prior_laplace``. Constant images cost nothing."""
    degree = np.asarray(mesh.adjacency.sum(axis=1)).ravel()
    laplacian = sp.csc_array(2 * (sp.diags_array(degree) - mesh.adjacency))
    return Penalty(laplacian, free_mean=True, places=mesh.centroids)


def tikhonov(mesh: Mesh) -> Penalty:
    """The integral of the squared image: triangles count by their area and are independent of each other.

    The variance of a single triangle has no limit as the mesh is refined, so that the mean over a hundredth of the
    sheet is what has variance one: then every mesh gives the same image.
    """
    return Penalty(sp.csc_array(sp.diags_array(mesh.measures / (0.01 * mesh.measures.sum()))), mean_variance=1.0)


def noser(model: TransferModel, exponent: float = 0.5) -> Prior:
    """NOSER (Cheney et al. 1990; EIDORS' ``prior_noser``): a power of J^T J's diagonal, all triangles seen alike.

    Args:
        model: The untouched sheet. J is that of adjacent drive round each of its rings.
        exponent: Of the diagonal: 0 weighs all triangles alike, 1 is the original, 0.5 the usual compromise.

    Raises:
        ModelError: If the exponent is not from 0 to 1.
    """
    if not 0 <= exponent <= 1:
        raise ModelError(f"NOSER exponent is {exponent}; it must be 0 to 1")

    def prior(mesh: Mesh) -> sp.csc_array:
        if mesh is not model.mesh:
            raise ModelError("this NOSER prior belongs to another model; make it with the model it is used on")
        rows = model.sensitivity(adjacent(model.electrodes.rings)) * model.conductivity
        diagonal = np.einsum("me,me->e", rows, rows)
        # a triangle that no datum feels must not be free to take any value
        return sp.csc_array(sp.diags_array(np.maximum(diagonal / diagonal.max(), 1e-12) ** exponent))

    return prior


def matern(length: float) -> Prior:
    """A Gaussian random field with a correlation length, the same on every mesh (Lindgren, Rue and Lindstroem 2011).

    The field solves (kappa^2 - Laplace) w = white noise in linear finite elements, which has Matern covariance of
    smoothness 1 in the plane (1/2 in space), variance one. A Robin condition at the rim (Roininen, Huttunen and
    Lasanen 2014) keeps the variance there from doubling. On meshes coarse for the length, triangles vary less.

    Args:
        length: Distance at which the correlation has fallen to about 0.14 (m); sqrt(8 nu) / kappa.

    Raises:
        ModelError: If the length is not positive, or, when used, below the mesh's edges.
    """
    if not (np.isfinite(length) and length > 0):
        raise ModelError(f"correlation length is {length!r}; it must be positive (m)")

    def prior(mesh: Mesh) -> Penalty:
        cells, dim = mesh.elements, mesh.dim
        edge = float(np.median(np.linalg.norm(mesh.corners[:, 0] - mesh.corners[:, 1], axis=1)))
        if length < edge:
            below = f"correlation length {length:.3g} m is below the mesh's edges of {edge:.3g} m"
            raise ModelError(f"{below}; refine the mesh")
        smoothness = 2 - dim / 2
        kappa = np.sqrt(8 * smoothness) / length
        mass = np.bincount(cells.ravel(), np.repeat(mesh.measures / (dim + 1), dim + 1), mesh.n_nodes)
        sizes = facet_measures(mesh.nodes, mesh.boundary, mesh.period)
        leak = np.bincount(mesh.boundary.ravel(), np.repeat(sizes / dim, dim), mesh.n_nodes) * kappa / 1.42
        operator = sp.csc_array(stiffness(mesh, np.ones(mesh.n_elem)) + sp.diags_array(kappa**2 * mass + leak))
        variance = 1 / (4 * np.pi * kappa**2) if dim == 2 else 1 / (8 * np.pi * kappa)  # far from the rim
        precision = sp.csc_array(operator @ sp.diags_array(variance / mass) @ operator)
        return Penalty(precision, triangle_means(mesh), mean_variance=1.0, places=mesh.nodes)

    return prior


def triangle_means(mesh: Mesh) -> sp.csr_array:
    """From values at nodes to their means over triangles: a sparse matrix (n_elem, n_nodes)."""
    corners = mesh.elements.shape[1]
    row = np.repeat(np.arange(mesh.n_elem), corners)
    share = np.full(mesh.elements.size, 1 / corners)
    return sp.csr_array((share, (row, mesh.elements.ravel())), shape=(mesh.n_elem, mesh.n_nodes))


def _matern(model: TransferModel) -> Prior:
    """Smooth, correlated over 15 % of the sheet's longest side."""
    return matern(0.15 * float(np.ptp(model.mesh.nodes, axis=0).max()))


PRIORS: Registry[Callable[[TransferModel], Prior]] = Registry(
    "prior",
    "ohmskin.priors",
    {
        "paper": lambda model: paper_laplacian,
        "laplacian": lambda model: graph_laplacian,
        "tikhonov": lambda model: tikhonov,
        "noser": noser,
        "matern": _matern,
    },
    ModelError,
    Callable,  # type: ignore[arg-type]
    " (TotalVariation and SparseBayes are estimators)",
)
"""Priors by name; other packages add theirs with an entry point of the group ``ohmskin.priors``."""


def penalty_of(model: TransferModel, prior: "Prior | str") -> Penalty:
    """The penalty of a prior, given as a function or by name, on a model's mesh.

    Raises:
        ModelError: If there is no such prior; the message lists those there are.
    """
    mesh = model.mesh
    found = (PRIORS[prior](model) if isinstance(prior, str) else prior)(mesh)
    if not isinstance(found, Penalty):
        matrix = checked_matrix(found)
        found = Penalty(matrix, places=mesh.centroids if len(mesh.centroids) == matrix.shape[0] else None)
    values = (found.matrix if found.image is None else found.image).shape[0]
    if values != mesh.n_elem:
        named = f"prior {prior!r}" if isinstance(prior, str) else "the prior"
        raise ModelError(f"{named} is of {values} values; give {mesh.n_elem}, one for each element of the mesh")
    return found
