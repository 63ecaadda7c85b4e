"""What several commands share."""

import os
import signal
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from ohmskin.child import when_input_ends
from ohmskin.device import Device, connect
from ohmskin.device.replay import ReplayDevice, recorded_skin
from ohmskin.errors import ModelError, OhmskinError, SkinError
from ohmskin.inverse import PRIORS
from ohmskin.inverse.choice import RULES
from ohmskin.inverse.estimators import ESTIMATORS
from ohmskin.skin import Fault, Skin


@dataclass(frozen=True)
class _Imaging:
    """How images are made.

    Args:
        estimator: What makes the image, such as kalman or total-variation (see `ohmskin info`); the mode's as usual.
        prior: What the estimator believes beforehand, such as paper or matern; the mode's unless given.
        rule: How the regularisation parameter is chosen, such as physical or l-curve; the mode's unless given.
    """

    estimator: str = ""
    prior: str = ""
    rule: str = ""

    def __post_init__(self) -> None:
        for option, table in (("estimator", ESTIMATORS), ("prior", [*PRIORS, "pixels"]), ("rule", RULES)):
            if (name := getattr(self, option)) and name not in table:
                raise ModelError(f"no {option} {name!r}; choose from {', '.join(table)}")


Imaging = Annotated[_Imaging, Parameter(name="*")]
"""The options ``--estimator``, ``--prior`` and ``--rule``, checked before anything is opened."""

AS_THE_MODE = _Imaging()
"""What the mode says."""


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
        if isinstance(opened, ReplayDevice) and (skin or opened.description):
            return opened, recorded_skin(opened, skin)
        return opened, Skin.load(skin or opened.default_skin)
    except BaseException:
        opened.close()
        raise


def check_seconds(seconds: float | None) -> None:
    """Raise unless a command may end after so many seconds."""
    if seconds is not None and not seconds > 0:
        raise OhmskinError(f"--seconds is {seconds:g}; it must be positive")


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
        when_input_ends(stop.set)
    return stop


def say(sentence: str) -> None:
    """Print a sentence now, whoever reads it."""
    print(sentence, flush=True)


def has_display() -> bool:
    """Whether a browser could show a page here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
