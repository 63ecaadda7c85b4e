"""The paper's experiments, figures of merit and their report.

    from ohmskin import evaluate

    task = evaluate.Localisation("discs", decibels=45, amplitude=0.1, seeds=20)
    print(evaluate.errors(task.run()).mean())

prints the mean error of all methods, places and seeds (m).
"""

from ohmskin.evaluate.experiments import (
    Discrimination,
    Localisation,
    MatchedLocalisation,
    Merits,
    PressedShapes,
    Sections,
    Touches,
)
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.merit import EidorsMerit, Merit, Target, eidors_figures, figures_of_merit
from ohmskin.evaluate.methods import METHODS, Bench, Method, all_methods, bench
from ohmskin.evaluate.shapes import Shape, disc
from ohmskin.evaluate.worlds import contact

__all__ = [
    "METHODS",
    "Bench",
    "Discrimination",
    "EidorsMerit",
    "Localisation",
    "MatchedLocalisation",
    "Merit",
    "Merits",
    "Method",
    "PressedShapes",
    "Sections",
    "Shape",
    "Target",
    "Touches",
    "all_methods",
    "bench",
    "contact",
    "disc",
    "eidors_figures",
    "errors",
    "figures_of_merit",
]
