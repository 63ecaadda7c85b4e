"""The pictures of the report, from results alone."""

from ohmskin.evaluate.figures.painting import Picture, draw

__all__ = ["Picture", "draw"]
