"""What several commands share."""

from ohmskin.device import Device, connect
from ohmskin.skin import Skin


def open_skin(device: str, skin: str) -> tuple[Device, Skin]:
    """Open a device and the description of its skin: the one named, the device's own, or the paper's."""
    scheme, _, rest = device.partition(":")
    if scheme == "virtual":
        description = Skin.load(skin or rest or "paper")
        return connect("virtual:", skin=description), description
    opened = connect(device)
    try:
        return opened, Skin.load(skin or opened.default_skin)
    except BaseException:
        opened.close()
        raise
