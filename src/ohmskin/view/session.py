"""The loop with a page: shows what the engine feels, and does what the page asks."""

import math
import time
from typing import Any

import numpy as np

from ohmskin.client.fields import as_json
from ohmskin.closing import Closing
from ohmskin.contacts import Contact
from ohmskin.device.demo import demo_finger
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine, State, Touch
from ohmskin.engine.health import Health
from ohmskin.errors import DataError, ModelError, OhmskinError
from ohmskin.geometry import Raster
from ohmskin.sensing import SkinModel
from ohmskin.skin import Mode, Press
from ohmskin.view.forces import GuidedForces
from ohmskin.view.live import LiveView
from ohmskin.view.setup import setup_of

_PIXELS = 64
_NOTE_SECONDS = 5.0
_LEAD = 8  # cycles seen unshown before a place that was sought; a contact is reported when it has come three times
_PATIENCE = 0.3  # s to wait for a browser that is to hear that the loop stands still for a while


class PageSession(Closing):
    """An engine and the page that shows it.

    Args:
        engine: The loop, not yet calibrated.
        url: The device's address, as the page should show it.
        view: The page, which is closed with the session.
        demo: Whether a demonstration finger wanders over a virtual skin until somebody presses.
    """

    def __init__(self, engine: Engine, url: str, view: LiveView, demo: bool) -> None:
        self._engine, self.view = engine, view
        self._raster = Raster(engine.skin.transfer_model().mesh, _PIXELS)
        self._demo = demo and engine.device.capabilities.virtual
        self._demo_from = time.monotonic()
        self._demo_pressing = False
        self._presses: dict[str, tuple[int, dict[str, Any]]] = {}  # number and what it is; 0 is the demonstration's
        self._last: Touch | None = None
        self._recording = engine.device if isinstance(engine.device, ReplayDevice) else None
        self._place = self._recording.position if self._recording else 0.0  # s, of the cycle that is shown
        self._sought, self._alone = False, False  # whether a place is not shown yet, and whether the loop pauses there
        self._note, self._note_until = "", 0.0
        self._preparing = ""
        self._forces, self._outcome = GuidedForces(engine), ""
        self._calibrated = 0.0  # share of the calibration that is under way
        view.show(setup_of(engine, url, self._raster, self._recording))

    def calibrate(self) -> None:
        """Learn the quiet skin, everything lifted, and say so on the page."""
        self._lift_all()
        self._stop_demo_press()
        self._engine.calibrate(self._progress)

    def step(self) -> Touch | None:
        """Do what the page asks, move the demonstration finger, run one cycle of the loop, show it.

        None also where a place in a recording was asked for: whoever leads the loop prepares for it first.
        """
        # first arrive, or a drag would never show anything
        on_the_way = self._sought and self._engine.state is State.RUNNING
        commands = [] if on_the_way else self.view.commands()
        for command in commands:
            try:
                self._execute(command)
            except OhmskinError as error:
                self._notify(str(error))
        if self._sought and any(command["type"] in ("seek", "step") for command in commands):
            return None
        if self._demo and self._engine.state is State.RUNNING:
            self._engine.press(0, *demo_finger(self._engine.skin.domain, time.monotonic() - self._demo_from))
            self._demo_pressing = True
        was_lost = self._engine.state is State.LOST
        recording = self._recording
        leading, at = (recording.leading, recording.position) if recording else (False, 0.0)
        if (touch := self._engine.step()) and recording:
            if leading:
                return None
            self._arrive(at)
        if was_lost and self._engine.state is State.RUNNING:  # a virtual skin started anew has forgotten its presses
            for number, press in self._presses.values():
                self._press(number, press, press["pressure"])
        if touch:
            self._forces.add(touch)
        self._last = touch or self._last
        self._publish()
        return touch

    def close(self) -> None:
        self.view.close()

    def _execute(self, command: dict[str, Any]) -> None:
        match command["type"]:
            case "press" if command["id"] in self._presses or self._engine.state is not State.LOST:
                self._set_demo(False)
                used = {held: number for held, (number, _) in self._presses.items()}
                free = next(number for number in range(1, 0x10000) if number not in used.values())
                number = used.get(command["id"], free)
                self._press(number, command, command["pressure"])
                self._presses[command["id"]] = number, command
            case "push":
                x, y, radius = (command[name] for name in ("x", "y", "radius"))
                per_pascal = Press((x, y), radius, 1.0).force(self._engine.skin.contact_layer.foam_spread)
                self._execute({**command, "type": "press", "pressure": command["force"] / per_pascal})
            case "lift":
                self._lift(command["id"])
            case "lift_all":
                self._lift_all()
            case "mode":
                self._prepare(self._engine.modes[command["mode"]])
                self._engine.set_mode(command["mode"])
            case "estimator":
                chosen = {name: command[name] for name in ("estimator", "prior", "rule")}
                self._prepare(self._engine.mode.using(**chosen))
                self._engine.set_estimator(**chosen)
            case "injections":
                self._engine.set_injections(command["count"])
            case "calibrate":
                self.calibrate()
            case "begin":
                self._forces.begin()
                self._outcome = ""
            case "weigh":
                self._forces.set_force(command["force"])
            case "save":
                self._save()
            case "pause":
                self._alone = command["paused"] and self._sought  # a place that was sought is shown first
                if not self._alone:
                    self._engine.pause(command["paused"])
            case "seek" | "step" | "speed" | "loop" if self._recording:
                self._transport(self._recording, command)
            case "demo":
                self._set_demo(command["on"] and self._engine.device.capabilities.virtual)

    def _notify(self, note: str) -> None:
        self._note, self._note_until = note, time.monotonic() + _NOTE_SECONDS

    def _progress(self, share: float) -> None:
        self._calibrated = share
        self._publish()

    def _prepare(self, mode: Mode) -> None:
        """Say that a mode is being prepared, before the loop stands still for that."""
        self._note_until = 0.0
        if self._engine.ready(mode):
            return
        self._report(f"{mode.label}: estimator {mode.estimator}, prior {mode.prior}, rule {mode.rule}")

    def _report(self, preparing: str) -> None:
        """Say what the loop stands still for, before it does."""
        until = time.monotonic() + _PATIENCE
        while not self.view.wants_frame() and time.monotonic() < until:
            time.sleep(0.005)
        self._preparing = preparing
        self._publish()
        self._preparing = ""

    def _save(self) -> None:
        """Save the newtons that guided presses say, and show the outcome on the page."""
        self._report("newtons from the presses")
        try:
            self._outcome = self._forces.save()
        except OhmskinError as error:
            self._outcome = f"Newtons are not calibrated: {error}"

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

    def _press(self, number: int, press: dict[str, Any], pressure: float) -> None:
        self._engine.press(number, (press["x"], press["y"]), press["radius"], pressure)

    def _lift(self, name: str) -> None:
        if held := self._presses.pop(name, None):
            self._press(*held, 0.0)

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
        touch = self._last
        base = image = np.full(self._raster.inside.shape, np.nan)
        known = self._engine.known
        sheet = float(known.model.conductivity.mean()) if known else self._engine.skin.sheet.conductivity
        scale = 1e3 * sheet  # relative change to millisiemens
        if touch is not None:
            try:
                base = image = self._raster(touch.percept.base_image.values) * scale
                if touch.percept.image is not touch.percept.base_image:
                    image = self._raster(touch.percept.image.values) * scale
            except ModelError as error:  # such as a rule that finds no parameter for these data
                self._notify(str(error))
            except DataError:  # no data yet that are good for an image, such as just after a change of mode
                pass
        self.view.publish(self._header(touch, scale), base, image)

    def _header(self, touch: Touch | None, scale: float) -> dict[str, Any]:
        engine, fresh = self._engine, time.monotonic() < self._note_until
        header: dict[str, Any] = {
            "sequence": touch.sequence if touch else 0,
            "time": touch.time if touch else time.monotonic(),
            "mode": engine.mode.name,
            **{name: getattr(engine.mode, name) for name in ("estimator", "prior", "rule")},
            "preparing": self._preparing,
            "guided": self._outcome,
            "progress": self._calibrated if self._engine.state is State.CALIBRATING else None,
            "contacts": [],
            "total_force": None,
            "gesture": None,
            "bad_electrodes": [],
            "findings": [],
            "base_injections": [],
            "injections": [],
            "n_injections": engine.injections,
            "presses": self._shown_presses(),
            "threshold": 0.0,
            "base_threshold": 0.0,
            "health": Health().figures,
            "state": engine.state.value,
            "message": self._note if fresh and engine.state is not State.LOST else engine.message,
            "demo": self._demo,
            "recording": self._playing(),
        }
        if touch and engine.sensor:
            frames, drive = touch.percept.frames, engine.drive(touch.mode)
            adapts = drive.scans > 1 or drive.adjustable  # what it drives depends on what is touched
            header |= {
                "contacts": [shown_contact(contact, scale) for contact in touch.contacts],
                "total_force": touch.percept.total_force,
                "gesture": touch.gesture and touch.gesture.as_json(),
                "bad_electrodes": sorted({*touch.percept.diagnosis.bad, *engine.sensor.known.bad}),
                "findings": _findings(touch, engine.sensor.known),
                "base_injections": frames[0].pattern.injections.tolist(),
                "injections": frames[-1].pattern.injections.tolist() if adapts else [],
                "threshold": engine.sensor.thresholds.final * scale,
                "base_threshold": engine.sensor.thresholds.base * scale,
                "health": touch.health.figures,
            }
        return header

    def _playing(self) -> dict[str, Any] | None:
        """Where a recording is and how it goes on; None on other devices."""
        if (recording := self._recording) is None:
            return None
        speed = recording.speed if math.isfinite(recording.speed) else None
        place = {"position": self._place, "length": recording.duration, "ended": recording.ended}
        return place | {"speed": speed, "loop": recording.loop}

    def _shown_presses(self) -> list[dict[str, Any]]:
        names = ("id", "x", "y", "radius", "pressure")
        shown: list[dict[str, Any]]
        shown = [{name: press[name] for name in names} | {"demo": False} for _, press in self._presses.values()]
        if self._demo_pressing:
            (x, y), radius, pressure = demo_finger(self._engine.skin.domain, time.monotonic() - self._demo_from)
            shown.append({"id": "demo", "x": x, "y": y, "radius": radius, "pressure": pressure, "demo": True})
        return shown


def _findings(touch: Touch, known: SkinModel) -> list[dict[str, Any]]:
    """What is wrong with data and electrodes: since the calibration, and lately."""
    verdicts = known.quality.verdicts if known.quality else ()
    standing = [{"words": f"electrode {v.electrode}: {v.words}", "electrodes": [v.electrode]} for v in verdicts]
    return standing + [{"words": f.words, "electrodes": list(f.cause.electrodes)} for f in touch.percept.findings]


def shown_contact(contact: Contact, scale: float) -> dict[str, Any]:
    """A contact as the page wants it: its peak in the unit of the image."""
    found = as_json(contact)
    x, y = found.pop("position")
    return {**found, "x": x, "y": y, "peak": contact.peak * scale}
