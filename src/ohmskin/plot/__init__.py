"""Pictures for files and papers: images with electrodes and contacts, maps of how well contacts are located."""

from ohmskin.plot.errors import ErrorMap, draw_error_map, save_error_maps
from ohmskin.plot.picture import draw_image, save_picture

__all__ = ["ErrorMap", "draw_error_map", "draw_image", "save_error_maps", "save_picture"]
