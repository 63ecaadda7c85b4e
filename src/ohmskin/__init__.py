"""ohmskin: a sense of touch from a handful of electrodes.

    import ohmskin as ohm

    skin = ohm.Skin.load("paper")
    with ohm.Engine(lambda: ohm.connect("virtual:", skin=skin), skin) as engine:
        engine.calibrate()
        for touch in engine.touches():
            for contact in touch.contacts:
                print(contact)

Parts are imported when they are first used, so that ``import ohmskin`` is quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "AbsoluteGaussNewton": "inverse",
    "Baseline": "scan",
    "Client": "client",
    "Contact": "touch",
    "ContactFinder": "touch",
    "Device": "device",
    "Disc": "geometry",
    "DiscFit": "inverse",
    "DrivePattern": "scan",
    "Electrodes": "geometry",
    "Engine": "engine",
    "FloatingPatches": "forward",
    "Frame": "scan",
    "GaussNewton": "inverse",
    "Greit": "inverse",
    "Image": "inverse",
    "Kalman": "inverse",
    "Mesh": "geometry",
    "OhmskinError": "errors",
    "Perception": "engine",
    "Polygon": "geometry",
    "Raster": "geometry",
    "Rectangle": "geometry",
    "Skin": "skin",
    "SparseBayes": "inverse",
    "TotalVariation": "inverse",
    "Touch": "engine",
    "Tracker": "touch",
    "TransferModel": "forward",
    "VirtualSkin": "skin",
    "VoltageSource": "forward",
    "adjacent": "scan",
    "connect": "device",
    "fit_background": "forward",
    "mesh_domain": "geometry",
    "mesh_graded": "geometry",
    "modes": "drive",
    "opposite": "scan",
    "read_mesh": "geometry",
    "read_recording": "record",
    "skip": "scan",
    "thicken": "geometry",
    "write_mesh": "geometry",
}

if TYPE_CHECKING:
    from ohmskin.client import Client
    from ohmskin.device import Device, connect
    from ohmskin.drive import modes
    from ohmskin.engine import Engine, Perception, Touch
    from ohmskin.errors import OhmskinError
    from ohmskin.forward import FloatingPatches, TransferModel, VoltageSource, fit_background
    from ohmskin.geometry import (
        Disc,
        Electrodes,
        Mesh,
        Polygon,
        Raster,
        Rectangle,
        mesh_domain,
        mesh_graded,
        read_mesh,
        thicken,
        write_mesh,
    )
    from ohmskin.inverse import AbsoluteGaussNewton, DiscFit, GaussNewton, Greit, Image, Kalman, SparseBayes, TotalVariation
    from ohmskin.record import read_recording
    from ohmskin.scan import Baseline, DrivePattern, Frame, adjacent, opposite, skip
    from ohmskin.skin import Skin, VirtualSkin
    from ohmskin.touch import Contact, ContactFinder, Tracker

__all__ = [
    "AbsoluteGaussNewton",
    "Baseline",
    "Client",
    "Contact",
    "ContactFinder",
    "Device",
    "Disc",
    "DiscFit",
    "DrivePattern",
    "Electrodes",
    "Engine",
    "FloatingPatches",
    "Frame",
    "GaussNewton",
    "Greit",
    "Image",
    "Kalman",
    "Mesh",
    "OhmskinError",
    "Perception",
    "Polygon",
    "Raster",
    "Rectangle",
    "Skin",
    "SparseBayes",
    "TotalVariation",
    "Touch",
    "Tracker",
    "TransferModel",
    "VirtualSkin",
    "VoltageSource",
    "adjacent",
    "connect",
    "fit_background",
    "mesh_domain",
    "mesh_graded",
    "modes",
    "opposite",
    "read_mesh",
    "read_recording",
    "skip",
    "thicken",
    "write_mesh",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ohmskin' has no attribute {name!r}")
    return getattr(import_module(f"ohmskin.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
