# ruff: noqa: F401
"""ohmskin: a sense of touch from a few electrodes.

    import ohmskin as ohm

    skin = ohm.Skin.load("paper")
    with ohm.Engine(lambda: ohm.connect("virtual:", skin=skin), skin) as engine:
        engine.calibrate()
        for touch in engine.touches():
            for contact in touch.contacts:
                print(contact)

Modules are imported when they are first used, so that ``import ohmskin`` is fast.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0.dev0"

_PACKAGES = {
    "client": "Client",
    "contacts": "Contact ContactFinder ContactFitter",
    "device": "Device connect",
    "engine": "Engine Touch",
    "errors": "OhmskinError",
    "forward": "ContactTable FloatingPatches TransferModel VoltageSource fit_background",
    "geometry": "Disc Electrodes Mesh Polygon Raster Rectangle mesh_domain mesh_graded read_mesh thicken write_mesh",
    "importers": "read_model read_recording",
    "inverse": "AbsoluteGaussNewton GaussNewton Greit Image Kalman SparseBayes TotalVariation",
    "scan": "Baseline Difference DrivePattern Frame adjacent opposite skip",
    "sensing": "Percept PressFitter Sensor SkinModel build modes perceive",
    "skin": "Mode Skin VirtualSkin",
    "tracking": "Tracker",
}
_HOMES = {name: package for package, names in _PACKAGES.items() for name in names.split()}

__all__ = sorted(_HOMES)

if TYPE_CHECKING:  # for editors
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
    from ohmskin.importers import read_model, read_recording
    from ohmskin.inverse import AbsoluteGaussNewton, GaussNewton, Greit, Image, Kalman, SparseBayes, TotalVariation
    from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, adjacent, opposite, skip
    from ohmskin.sensing import Percept, PressFitter, Sensor, SkinModel, build, modes, perceive
    from ohmskin.skin import Mode, Skin, VirtualSkin
    from ohmskin.tracking import Tracker


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        if name.startswith("_") or find_spec(f"ohmskin.{name}") is None:
            raise AttributeError(f"module 'ohmskin' has no attribute {name!r}")
        return import_module(f"ohmskin.{name}")
    return getattr(import_module(f"ohmskin.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
