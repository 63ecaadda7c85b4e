"""Packages that only some need, imported when they are."""

from importlib import import_module
from typing import Any

from ohmskin.errors import GeometryError


def optional(package: str) -> Any:
    """The package of the extra ``mesh``; raises GeometryError with the line that installs it."""
    try:
        return import_module(package)
    except (ImportError, OSError) as error:  # gmsh raises OSError where the system lacks its graphics libraries
        raise GeometryError(f"cannot import {package} ({error}); use: pip install 'ohmskin[mesh]'") from error
