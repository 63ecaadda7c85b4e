"""MuJoCo, imported so that it computes without a graphics library and draws with the one there is."""

import ctypes
import os
import sys

from ohmskin.errors import ModelError

_INSTALL = "install what draws without a display: apt-get install libegl1 libgl1"
_LIBRARIES = {"egl": ("libEGL.so.1", "libGL.so.1"), "osmesa": ("libOSMesa.so.8",)}  # the first of these that is there


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


_found: list[str] = []
_early = "mujoco" in sys.modules  # it has chosen already what draws: windows, unless MUJOCO_GL said otherwise
if sys.platform == "linux":  # MuJoCo reads MUJOCO_GL when it is imported, and fails there if a library is missing
    _found = [name for name, libraries in _LIBRARIES.items() if all(map(_loads, libraries))]
    os.environ.setdefault("MUJOCO_GL", _found[0] if _found else "disable")

try:
    import mujoco
except ImportError as error:
    raise ModelError("the robot demonstration needs MuJoCo; install it: pip install 'ohmskin[robot]'") from error


def check_display() -> None:
    """Raise `ModelError` if there is no library to draw with, `DataError` if the extra `plot` is missing."""
    import ohmskin.plot  # noqa: F401 (here: simulations need no pictures)

    if os.environ.get("MUJOCO_GL") == "disable":
        raise ModelError(f"a picture needs a graphics library; {_INSTALL}")


def renderer(model: "mujoco.MjModel", width: int, height: int) -> "mujoco.Renderer":
    """Draws a model's scenes, in pictures of so many pixels.

    Raises:
        ModelError: If there is no library to draw with, or it cannot draw here.
    """
    check_display()
    try:
        return mujoco.Renderer(model, height, width)
    except Exception as error:
        remedy = f"import ohmskin.robot before mujoco, or set MUJOCO_GL={_found[0]}" if _early and _found else _INSTALL
        raise ModelError(f"MuJoCo cannot draw here ({error}); {remedy}") from error


__all__ = ["check_display", "mujoco", "renderer"]
