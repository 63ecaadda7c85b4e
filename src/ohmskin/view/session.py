"""The loop with a page: shows what the engine feels, and does what the page asks."""

import math
import time
from typing import Any

import numpy as np

import ohmskin
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import DeviceError, PatternError
from ohmskin.geometry import Disc, Raster
from ohmskin.skin import Skin
from ohmskin.touch import Contact
from ohmskin.view.demo import demo_finger
from ohmskin.view.live import LiveView

_PIXELS = 64
_NOTE_SECONDS = 5.0
_RADIUS = [3e-3, 20e-3, 8e-3]  # m: least, largest and usual radius of a press on the page
_PRESSURE = [1e3, 60e3, 20e3]  # Pa, likewise
_LEAD = 8  # cycles seen unshown before a place that was sought; a contact is reported when it has come three times
_PAPER_SKINS = {"12B": "paper", "16B": "paper-rim16", "16I": "paper", "16O": "paper"}  # the skin for each of the paper's modes


class Session:
    """An engine and the page that shows it.

    Args:
        engine: The loop, not yet calibrated.
        url: The device's address, as the page should show it.
        host, port, token: Where the page is served; see `LiveView`.
        demo: Whether a demonstration finger wanders over a virtual skin until somebody presses.
    """

    def __init__(self, engine: Engine, url: str, host: str, port: int, token: str | None, demo: bool) -> None:
        self._engine, self._url = engine, url
        self._raster = Raster(engine.skin.mesh(), _PIXELS)
        self._demo = demo and engine.device.capabilities.virtual
        self._demo_from = time.monotonic()
        self._demo_pressing = False
        self._numbers: dict[str, int] = {}  # press number of each press id of the page; 0 is the demonstration's
        self._presses: dict[str, dict[str, Any]] = {}
        self._last: Touch | None = None
        device = getattr(engine.device, "inner", engine.device)  # a recorder may listen in
        self._recording = device if isinstance(device, ReplayDevice) else None
        self._place = self._recording.position if self._recording else 0.0  # s, of the cycle that is shown
        self._sought, self._alone = False, False  # whether a place is not shown yet, and whether the loop pauses there
        self._note, self._note_until = "", 0.0
        self.view = LiveView(self._setup(), host, port, token)

    def calibrate(self) -> None:
        """Learn the quiet skin, everything lifted, and say so on the page."""
        self._lift_all()
        self._stop_demo_press()
        self._engine.calibrate(lambda _: self._publish())

    def step(self) -> Touch | None:
        """Do what the page asks, move the demonstration finger, run one cycle of the loop, show it.

        None also where a place in a recording was asked for: whoever leads the loop prepares for it before the next call.
        """
        on_the_way = self._sought and self._engine.state is State.RUNNING  # first arrive, or a drag would never show anything
        commands = [] if on_the_way else self.view.commands()
        for command in commands:
            try:
                self._obey(command)
            except (DeviceError, PatternError) as error:
                self._note, self._note_until = str(error), time.monotonic() + _NOTE_SECONDS
        if self._sought and any(command["type"] in ("seek", "step") for command in commands):
            return None
        if self._demo and self._engine.state is State.RUNNING:
            self._engine.press(0, *demo_finger(self._engine.skin.domain, time.monotonic() - self._demo_from))
            self._demo_pressing = True
        was_lost = self._engine.state is State.LOST
        if (recording := self._recording) is not None:
            leading, at = recording.leading, recording.position
            touch = self._engine.step()
            if touch and leading:
                return None
            if touch:
                self._arrive(at)
        else:
            touch = self._engine.step()
        if was_lost and self._engine.state is State.RUNNING:  # a virtual skin that was started anew has forgotten its presses
            for name, press in self._presses.items():
                self._engine.press(self._numbers[name], (press["x"], press["y"]), press["radius"], press["pressure"])
        self._last = touch or self._last
        self._publish()
        return touch

    def close(self) -> None:
        """Close the page. Safe twice."""
        self.view.close()

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _obey(self, command: dict[str, Any]) -> None:
        match command["type"]:
            case "press":
                self._set_demo(False)
                number = self._numbers.setdefault(command["id"], self._free_number())
                self._engine.press(number, (command["x"], command["y"]), command["radius"], command["pressure"])
                self._presses[command["id"]] = {**command, "demo": False}
            case "lift":
                self._lift(command["id"])
            case "lift_all":
                self._lift_all()
            case "mode":
                self._engine.set_mode(command["mode"])
            case "injections":
                self._engine.set_injections(command["count"])
            case "calibrate":
                self.calibrate()
            case "pause":
                self._alone = command["paused"] and self._sought  # a place that was sought is shown first
                if not self._alone:
                    self._engine.pause(command["paused"])
            case "seek" | "step" | "speed" | "loop" if self._recording:
                self._transport(self._recording, command)
            case "demo":
                self._set_demo(command["on"] and self._engine.device.capabilities.virtual)

    def _transport(self, recording: ReplayDevice, command: dict[str, Any]) -> None:
        match command["type"]:
            case "seek":
                recording.seek(command["position"], _LEAD)
                self._go(alone=self._alone or self._engine.state is State.PAUSED)
            case "step":
                on = command["cycles"]
                if self._sought or on < 0:
                    recording.step(on if self._sought else on - 1, _LEAD)  # the next cycle is the one after that shown
                elif recording.ended:
                    self._engine.pause(True)
                    return
                self._go(alone=True)
            case "speed":
                recording.speed = math.inf if command["speed"] is None else command["speed"]
            case "loop":
                recording.loop = command["on"]

    def _go(self, alone: bool) -> None:
        """Run until a place is shown; pause there if it is asked for alone."""
        self._sought, self._alone = True, alone
        self._engine.pause(False)

    def _arrive(self, at: float) -> None:
        self._place, self._sought = at, False
        if self._alone:
            self._alone = False
            self._engine.pause(True)

    def _free_number(self) -> int:
        return next(n for n in range(1, 0x10000) if n not in self._numbers.values())

    def _lift(self, name: str) -> None:
        if press := self._presses.pop(name, None):
            self._engine.press(self._numbers.pop(name), (press["x"], press["y"]), press["radius"], 0.0)

    def _lift_all(self) -> None:
        for name in list(self._presses):
            self._lift(name)

    def _set_demo(self, on: bool) -> None:
        if on and not self._demo:
            self._demo_from = time.monotonic()
        self._demo = on
        if not on:
            self._stop_demo_press()

    def _stop_demo_press(self) -> None:
        if self._demo_pressing:
            at, radius, _ = demo_finger(self._engine.skin.domain, 0.0)
            self._engine.press(0, at, radius, 0.0)
            self._demo_pressing = False

    def _publish(self) -> None:
        if not self.view.wants_frame():
            return
        scale = 1e3 * self._conductivity()  # relative change to millisiemens
        touch = self._last
        if touch is None:
            blank = np.full(self._raster.inside.shape, np.nan)
            self.view.publish(self._header(None, 0.0), blank, blank)
            return
        base = self._raster(touch.sight.base.values) * scale
        image = base if touch.sight.image is touch.sight.base else self._raster(touch.sight.image.values) * scale
        self.view.publish(self._header(touch, scale), base, image)

    def _conductivity(self) -> float:
        perception = self._engine.perception
        return float(perception.model.conductivity.mean()) if perception else self._engine.skin.sheet.conductivity

    def _header(self, touch: Touch | None, scale: float) -> dict[str, Any]:
        engine = self._engine
        header: dict[str, Any] = {
            "sequence": touch.sequence if touch else 0,
            "time": touch.time if touch else time.monotonic(),
            "mode": engine.mode.name,
            "contacts": [],
            "base_injections": [],
            "injections": [],
            "n_injections": engine.injections,
            "presses": self._shown_presses(),
            "threshold": 0.0,
            "health": {"rate": 0.0, "latency_p50": 0.0, "latency_p99": 0.0, "dropped": 0, "noise": 0.0, "waiting": 0.0},
            "state": engine.state.value,
            "message": engine.message or (self._note if time.monotonic() < self._note_until else ""),
            "demo": self._demo,
            "recording": self._playing(),
        }
        if touch and engine.perception:
            frames = touch.sight.frames
            header |= {
                "contacts": [
                    {
                        "id": contact.id,
                        "x": contact.position[0],
                        "y": contact.position[1],
                        "extent": contact.extent,
                        "strength": contact.strength,
                        "confidence": contact.confidence,
                        "peak": contact.peak * scale,
                        "covariance": _ellipse(contact),
                    }
                    for contact in touch.contacts
                ],
                "base_injections": frames[0].pattern.injections.tolist(),
                "injections": frames[-1].pattern.injections.tolist() if touch.mode.optimal or touch.mode.policy else [],
                "threshold": engine.perception.thresholds[touch.mode.name].final * scale,
                "health": {
                    name: getattr(touch.health, name)
                    for name in ("rate", "latency_p50", "latency_p99", "dropped", "noise", "waiting")
                },
            }
        return header

    def _playing(self) -> dict[str, Any] | None:
        """Where a recording is and how it goes on; None on other devices."""
        if (recording := self._recording) is None:
            return None
        speed = recording.speed if math.isfinite(recording.speed) else None
        return {"position": self._place, "length": recording.duration, "speed": speed, "loop": recording.loop}

    def _shown_presses(self) -> list[dict[str, Any]]:
        shown = [{name: press[name] for name in ("id", "x", "y", "radius", "pressure", "demo")} for press in self._presses.values()]
        if self._demo_pressing:
            (x, y), radius, pressure = demo_finger(self._engine.skin.domain, time.monotonic() - self._demo_from)
            shown.append({"id": "demo", "x": x, "y": y, "radius": radius, "pressure": pressure, "demo": True})
        return shown

    def _setup(self) -> dict[str, Any]:
        engine, skin, raster = self._engine, self._engine.skin, self._raster
        virtual = engine.device.capabilities.virtual
        return {
            "version": ohmskin.__version__,
            "skin": {
                "name": skin.name,
                "domain": _domain(skin),
                "electrodes": [{"x": x, "y": y} for x, y in skin.electrodes.positions.tolist()],
            },
            "raster": {
                "x0": float(raster.x[0]),
                "y0": float(raster.y[0]),
                "pitch": raster.pitch,
                "nx": len(raster.x),
                "ny": len(raster.y),
            },
            "modes": self._modes(),
            "device": {"url": self._url, "virtual": virtual},
            "unit": "mS",
            "press": {"radius": _RADIUS, "pressure": _PRESSURE} if virtual else None,
            "recording": {"length": self._recording.duration} if self._recording else None,
        }

    def _modes(self) -> list[dict[str, Any]]:
        possible = self._engine.modes
        shown: list[dict[str, Any]] = [
            {
                "name": m.name,
                "title": m.title,
                "available": True,
                "why_not": "",
                "injections": self._engine.injection_limits(m) if m.policy else None,
            }
            for m in possible.values()
        ]
        if not self._engine.device.reference:
            for name, fits in _PAPER_SKINS.items():
                if name not in possible:
                    why = f"needs other electrodes: ohmskin live --skin {fits}"
                    shown.append({"name": name, "title": f"the paper's mode {name}", "available": False, "why_not": why})
        return sorted(shown, key=lambda mode: (mode["name"][:2], "BIOPT".find(mode["name"][-1])))


def _ellipse(contact: Contact) -> tuple[float, float, float] | None:
    """Covariance xx, xy, yy (m2) of a contact's place, where it is known."""
    if contact.covariance is None:
        return None
    (xx, xy), (_, yy) = contact.covariance
    return xx, xy, yy


def _domain(skin: Skin) -> dict[str, Any]:
    if isinstance(skin.domain, Disc):
        return {"kind": "disc", "radius": skin.sheet.radius}
    return {"kind": "rectangle", "width": skin.sheet.width, "height": skin.sheet.height}
