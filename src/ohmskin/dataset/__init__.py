"""Simulated touches by the million, for learning: voltages, truth and parameters."""

from ohmskin.dataset.generate import generate
from ohmskin.dataset.recipe import Recipe

__all__ = ["Recipe", "generate"]
