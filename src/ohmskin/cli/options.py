"""What several commands share."""

import os
import signal
import sys
import threading
from collections.abc import Sequence

from ohmskin.device import Device, connect
from ohmskin.errors import OhmskinError, SkinError
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


def check_seed(seed: int | None) -> None:
    """Raise unless noise can be made of this seed."""
    if seed is not None and not 0 <= seed < 2**63:
        raise OhmskinError(f"--seed is {seed}; it must be 0 to 2^63 - 1")


def asked_to_stop(lifeline: bool = False) -> threading.Event:
    """Set at Ctrl-C or SIGTERM and, with a `lifeline`, at the end of standard input."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if lifeline:

        def end_with_input() -> None:
            sys.stdin.read()
            stop.set()

        threading.Thread(target=end_with_input, daemon=True).start()
    return stop


def say(sentence: str) -> None:
    """Print a sentence now, whoever reads it."""
    print(sentence, flush=True)


def has_display() -> bool:
    """Whether a browser could show a page here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
