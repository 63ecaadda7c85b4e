"""What sphinx-gallery needs to know of the examples: they write their picture to the folder that they are given."""

import tempfile
import warnings
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

FOLDER = Path(tempfile.gettempdir(), "ohmskin-examples")
_filters = list(warnings.filters)


def arguments(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """The command line of an example: where to leave its picture."""
    FOLDER.mkdir(exist_ok=True)
    return [str(FOLDER)]


def take(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Take the pictures that a block has left, and return the text that shows them."""
    taken = []
    for picture in sorted(FOLDER.glob("*.png")):
        path = Path(next(block_vars["image_path_iterator"]))
        path.write_bytes(picture.read_bytes())
        picture.unlink()
        taken.append(path)
    return figure_rst([str(path) for path in taken], gallery_conf["src_dir"])


def strict(gallery_conf: dict[str, Any], name: str, when: str) -> None:
    """Make warnings of an example errors while it runs."""
    if when == "before":
        _filters[:] = warnings.filters
        warnings.simplefilter("error")
    else:
        warnings.filters[:] = _filters  # type: ignore[index]
