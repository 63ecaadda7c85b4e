"""What several commands share."""

import os
import sys
from collections.abc import Sequence

from ohmskin.device import Device, connect
from ohmskin.errors import SkinError
from ohmskin.skin import Fault, Skin


def open_skin(device: str, skin: str, faults: Sequence[Fault] = ()) -> tuple[Device, Skin]:
    """Open a device and the description of its skin: the one named, the device's own, or the paper's.

    Raises:
        SkinError: If a real skin is to have `faults`.
    """
    scheme, _, rest = device.partition(":")
    if scheme == "virtual":
        description = Skin.load(skin or rest or "paper")
        return connect("virtual:", skin=description, faults=faults), description
    if faults:
        raise SkinError(f"--fault is for virtual: only; give it to `ohmskin serve-skin` if {device} is one of those")
    opened = connect(device)
    try:
        if (recorded := getattr(opened, "description", "")) and not skin:
            return opened, Skin.parse(recorded, f"the skin in {device}")
        return opened, Skin.load(skin or opened.default_skin)
    except BaseException:
        opened.close()
        raise


def has_display() -> bool:
    """Whether a browser could show a page here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
