"""Data sets of simulated touches, for learning: voltages, truth and parameters."""

from ohmskin.dataset.generate import generate
from ohmskin.dataset.load import SPLITS, TouchData
from ohmskin.dataset.recipe import Recipe

__all__ = ["SPLITS", "Recipe", "TouchData", "generate"]
