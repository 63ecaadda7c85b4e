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
    "Contact": "contacts",
    "ContactFinder": "contacts",
    "ContactFitter": "contacts",
    "ContactTable": "forward",
    "Difference": "scan",
    "Device": "device",
    "Disc": "geometry",
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
    "Mode": "skin",
    "Percept": "sensing",
    "Polygon": "geometry",
    "Raster": "geometry",
    "Rectangle": "geometry",
    "Sensor": "sensing",
    "Skin": "skin",
    "SkinModel": "sensing",
    "SparseBayes": "inverse",
    "TotalVariation": "inverse",
    "Touch": "engine",
    "Tracker": "tracking",
    "TransferModel": "forward",
    "VirtualSkin": "skin",
    "VoltageSource": "forward",
    "adjacent": "scan",
    "build": "sensing",
    "connect": "device",
    "fit_background": "forward",
    "mesh_domain": "geometry",
    "mesh_graded": "geometry",
    "modes": "sensing",
    "opposite": "scan",
    "perceive": "sensing",
    "read_mesh": "geometry",
    "read_recording": "importers",
    "skip": "scan",
    "thicken": "geometry",
    "write_mesh": "geometry",
}

if TYPE_CHECKING:
    from ohmskin.client import Client
    from ohmskin.contacts import Contact, ContactFinder, ContactFitter
    from ohmskin.device import Device, connect
    from ohmskin.engine import Engine, Touch
    from ohmskin.errors import OhmskinError
    from ohmskin.forward import ContactTable, FloatingPatches, TransferModel, VoltageSource, fit_background
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
    from ohmskin.importers import read_recording
    from ohmskin.inverse import (
        AbsoluteGaussNewton,
        GaussNewton,
        Greit,
        Image,
        Kalman,
        SparseBayes,
        TotalVariation,
    )
    from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, adjacent, opposite, skip
    from ohmskin.sensing import Percept, Sensor, SkinModel, build, modes, perceive
    from ohmskin.skin import Mode, Skin, VirtualSkin
    from ohmskin.tracking import Tracker

__all__ = [
    "AbsoluteGaussNewton",
    "Baseline",
    "Client",
    "Contact",
    "ContactFinder",
    "ContactFitter",
    "ContactTable",
    "Device",
    "Difference",
    "Disc",
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
    "Mode",
    "OhmskinError",
    "Percept",
    "Polygon",
    "Raster",
    "Rectangle",
    "Sensor",
    "Skin",
    "SkinModel",
    "SparseBayes",
    "TotalVariation",
    "Touch",
    "Tracker",
    "TransferModel",
    "VirtualSkin",
    "VoltageSource",
    "adjacent",
    "build",
    "connect",
    "fit_background",
    "mesh_domain",
    "mesh_graded",
    "modes",
    "opposite",
    "perceive",
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
