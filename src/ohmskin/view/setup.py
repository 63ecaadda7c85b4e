"""What is sent to the live page first: the skin, its modes, and what images can be made with."""

from typing import Any

import ohmskin
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine
from ohmskin.geometry import Raster
from ohmskin.inverse import PRIORS
from ohmskin.inverse.choice import RULES
from ohmskin.inverse.estimators import ESTIMATORS
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.publisher import describe_domain
from ohmskin.sensing import modes
from ohmskin.skin import Mode, Skin

_RADIUS = [3e-3, 20e-3, 8e-3]  # m: least, largest and usual radius of a press on the page
_PRESSURE = [1e3, 60e3, 20e3]  # Pa, likewise
_PAPER_SKINS = ("paper", "paper-rim16")  # the skins of the paper, whose modes are shown on any


def setup_of(engine: Engine, url: str, raster: Raster, recording: ReplayDevice | None) -> dict[str, Any]:
    """The setup of a page (docs/live-page.md).

    Args:
        engine: The loop.
        url: The device's address, as the page should show it; of a recording it shows the file's name.
        raster: Pixels of the images.
        recording: The device, if it is a recording.
    """
    skin, virtual = engine.skin, engine.device.capabilities.virtual
    return {
        "version": ohmskin.__version__,
        "skin": {
            "name": skin.name,
            "domain": describe_domain(skin),
            "electrodes": [{"x": x, "y": y} for x, y in skin.electrodes.positions.tolist()],
        },
        **Picture.setup(raster),
        "modes": _modes(engine),
        "choices": _choices(engine),
        "device": {"url": recording.path.name if recording else url, "virtual": virtual},
        "unit": "mS",
        "press": {"radius": _RADIUS, "pressure": _PRESSURE} if virtual else None,
        "recording": {"length": recording.duration} if recording else None,
    }


def _modes(engine: Engine) -> list[dict[str, Any]]:
    """The modes that are possible, then those of the paper that are not."""
    shown = {mode.name: _mode(mode) for mode in engine.modes.values()}
    for mode in engine.modes.values():
        if engine.drive(mode).adjustable:
            shown[mode.name]["injections"] = engine.injection_limits(mode)
    for fits in () if engine.device.reference else _PAPER_SKINS:
        for mode in modes(Skin.load(fits)).values():
            if mode.reader == "centroid":  # as in the paper
                shown.setdefault(mode.name, _mode(mode, f"needs other electrodes: ohmskin live --skin {fits}"))
    return list(shown.values())


def _mode(mode: Mode, why_not: str = "") -> dict[str, Any]:
    return {
        "name": mode.name,
        "title": mode.title or mode.name,
        "summary": mode.summary,
        "available": not why_not,
        "why_not": why_not,
        "injections": None,
    }


def _choices(engine: Engine) -> dict[str, list[dict[str, str]]]:
    """What images can be made with, what the skin's own modes name included."""
    priors = dict.fromkeys([*PRIORS, *(mode.prior for mode in engine.modes.values())])
    return {
        "estimator": [{"name": name, "title": ESTIMATORS.title(name)} for name in ESTIMATORS],
        "prior": [{"name": name, "title": name} for name in priors],
        "rule": [{"name": name, "title": name} for name in RULES],
    }
