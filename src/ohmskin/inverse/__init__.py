"""From voltages to images: priors and estimators."""

from ohmskin.inverse.gauss_newton import GaussNewton, Image, Prior
from ohmskin.inverse.priors import paper_laplacian

__all__ = ["GaussNewton", "Image", "Prior", "paper_laplacian"]
