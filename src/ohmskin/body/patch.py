"""The process of one patch: its loop and its boards.

`ohmskin.body.patches` starts it; it ends with its standard input.
"""

import gc
import threading
import time
from collections.abc import Callable
from typing import Any

from ohmskin.child import begin, when_input_ends
from ohmskin.client.felt import patches_from
from ohmskin.device import Device, connect
from ohmskin.device.demo import demo_finger
from ohmskin.engine import Engine, State
from ohmskin.errors import DeviceError, OhmskinError
from ohmskin.outlets.publisher import Publisher
from ohmskin.skin import Skin

_RETRY_AFTER = 1.0
_REPORT_EVERY = 0.5


class PatchLoop:
    """Senses with one patch until it is told to stop.

    Args:
        settings: `device`, `skin` (TOML), `mode`, `patch`, `name` of its boards, most `images` per second, and whether
            a demonstration finger presses it (`demo`).
        answer: Takes how it goes, by keyword.
        stop: Set to end.
    """

    def __init__(self, settings: dict[str, Any], answer: Callable[..., None], stop: threading.Event) -> None:
        self._skin = Skin.parse(settings["skin"])
        self._device, self._mode, self._demo = settings["device"], settings["mode"], settings["demo"]
        (self._patch,) = patches_from({"patches": [settings["patch"]]})
        self._name, self._images, self._stop = settings["name"], settings["images"], stop
        self._answer = answer

    def run(self) -> None:
        """Open, calibrate, sense; when the device cannot be reached, say so and try again."""
        with Publisher(self._skin, (), self._name, self._patch, images=self._images) as publisher:
            while not self._stop.is_set():
                try:
                    with Engine(self._open, self._skin, self._mode, self._report) as engine:
                        self._sense(engine, publisher)
                except DeviceError as error:
                    self._answer(state="lost", message=str(error))
                    self._stop.wait(_RETRY_AFTER)

    def _report(self, text: str) -> None:
        self._answer(message=text)

    def _open(self) -> Device:
        if self._device == "virtual:":
            return connect(self._device, skin=self._skin)
        return connect(self._device)

    def _sense(self, engine: Engine, publisher: Publisher) -> None:
        self._answer(state="calibrating", message="", press=getattr(engine.device, "address", ""))
        engine.calibrate()
        gc.collect()
        gc.freeze()
        due, began = 0.0, time.monotonic()
        while not self._stop.is_set():
            if self._demo and engine.state is State.RUNNING:
                engine.press(0, *demo_finger(self._skin.domain, time.monotonic() - began))
            touch = engine.step()
            if touch is not None:
                publisher.publish(touch)
            if (now := time.monotonic()) >= due:
                due = now + _REPORT_EVERY
                health = touch.health if touch is not None else None
                figures = health and {"rate": health.rate, "p50": health.latency_p50, "p99": health.latency_p99}
                self._answer(state=engine.state.value, **(figures or {}))


def main() -> None:
    """Run one patch."""
    settings, answer = begin()
    stop = threading.Event()
    when_input_ends(stop.set)
    try:
        PatchLoop(settings, answer, stop).run()
    except OhmskinError as error:
        answer(failed=str(error))


if __name__ == "__main__":
    main()
