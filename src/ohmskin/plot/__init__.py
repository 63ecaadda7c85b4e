"""Pictures for files and papers: images with electrodes and contacts, maps of position errors, meshes."""

from importlib.util import find_spec

from ohmskin.errors import DataError

if find_spec("matplotlib") is None:
    raise DataError("pictures need Matplotlib; install it: pip install 'ohmskin[plot]'")

from ohmskin.plot.errors import ErrorMap, draw_error_map, save_error_maps
from ohmskin.plot.model import draw_current, draw_mesh
from ohmskin.plot.picture import draw_image, save_picture

__all__ = ["ErrorMap", "draw_current", "draw_error_map", "draw_image", "draw_mesh", "save_error_maps", "save_picture"]
