"""From voltages to images: priors, estimators, and rules for the regularisation parameter."""

from ohmskin.inverse.absolute import AbsoluteGaussNewton, Iterations
from ohmskin.inverse.choice import (
    RULES,
    Choice,
    choose,
    cross_validation,
    discrepancy,
    evidence,
    l_curve,
    noise_figure,
    physical,
)
from ohmskin.inverse.eidors import EIDORS_PRIORS, ReconstructionMatrix, eidors_one_step
from ohmskin.inverse.estimators import ESTIMATORS, Estimate, Estimator, EstimatorSettings, FrameWise, image_of
from ohmskin.inverse.gauss_newton import GaussNewton
from ohmskin.inverse.greit import Greit
from ohmskin.inverse.image import Image
from ohmskin.inverse.kalman import Kalman, KalmanState
from ohmskin.inverse.modes import ImageModes
from ohmskin.inverse.pixels import Pixels
from ohmskin.inverse.priors import PRIORS, Penalty, Prior, graph_laplacian, matern, noser, paper_laplacian, tikhonov
from ohmskin.inverse.quality import ModelMatch, match_model
from ohmskin.inverse.sparse import SparseBayes
from ohmskin.inverse.variation import TotalVariation

__all__ = [
    "EIDORS_PRIORS",
    "ESTIMATORS",
    "PRIORS",
    "RULES",
    "AbsoluteGaussNewton",
    "Choice",
    "Estimate",
    "Estimator",
    "EstimatorSettings",
    "FrameWise",
    "GaussNewton",
    "Greit",
    "Image",
    "ImageModes",
    "Iterations",
    "Kalman",
    "KalmanState",
    "ModelMatch",
    "Penalty",
    "Pixels",
    "Prior",
    "ReconstructionMatrix",
    "SparseBayes",
    "TotalVariation",
    "choose",
    "cross_validation",
    "discrepancy",
    "eidors_one_step",
    "evidence",
    "graph_laplacian",
    "image_of",
    "l_curve",
    "match_model",
    "matern",
    "noise_figure",
    "noser",
    "paper_laplacian",
    "physical",
    "tikhonov",
]
