"""The process of one patch: its loop and its boards. `ohmskin.publish.patches` starts it; it ends with its standard input."""

import gc
import json
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from ohmskin.client.felt import patches_from
from ohmskin.device import Device, connect
from ohmskin.engine import Engine, State
from ohmskin.errors import DeviceError, OhmskinError
from ohmskin.publish.publisher import Publisher
from ohmskin.skin import Skin

_RETRY_AFTER = 1.0
_TELL_EVERY = 0.5


class PatchLoop:
    """Senses with one patch until it is told to stop.

    Args:
        settings: `device`, `skin` (TOML), `mode`, `patch`, `name` of its boards, most `images` per second, and whether a
            demonstration finger presses it (`demo`).
        stop: Set to end.
    """

    def __init__(self, settings: dict[str, Any], stop: threading.Event) -> None:
        self._skin = Skin.parse(settings["skin"])
        self._device, self._mode, self._demo = settings["device"], settings["mode"], settings["demo"]
        (self._patch,) = patches_from({"patches": [settings["patch"]]})
        self._name, self._images, self._stop = settings["name"], settings["images"], stop
        # Standard output carries what is told, so that whatever a library prints must go elsewhere.
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def run(self) -> None:
        """Open, calibrate, sense; when the device cannot be reached, say so and try again."""
        with Publisher(self._skin, (), self._name, self._patch, images=self._images) as publisher:
            while not self._stop.is_set():
                try:
                    with Engine(self._open, self._skin, self._mode, report=lambda text: self.tell(message=text)) as engine:
                        self._sense(engine, publisher)
                except DeviceError as error:
                    self.tell(state="lost", message=str(error))
                    self._stop.wait(_RETRY_AFTER)

    def _open(self) -> Device:
        if self._device == "virtual:":
            return connect(self._device, skin=self._skin)
        return connect(self._device)

    def _sense(self, engine: Engine, publisher: Publisher) -> None:
        self.tell(state="calibrating", message="", press=getattr(engine.device, "address", ""))
        engine.calibrate()
        gc.collect()
        gc.freeze()
        due, began = 0.0, time.monotonic()
        while not self._stop.is_set():
            if self._demo and engine.state is State.RUNNING:
                engine.press(0, *_finger(self._skin, time.monotonic() - began))
            touch = engine.step()
            if touch is not None:
                publisher.publish(touch)
            if (now := time.monotonic()) >= due:
                due = now + _TELL_EVERY
                health = touch.health if touch is not None else None
                figures = {} if health is None else {"rate": health.rate, "p50": health.latency_p50, "p99": health.latency_p99}
                self.tell(state=engine.state.value, **figures)

    def tell(self, **what: object) -> None:
        """Say something to who started this."""
        with suppress(OSError):
            print(json.dumps(what), file=self._out, flush=True)


def _finger(skin: Skin, seconds: float) -> tuple[tuple[float, float], float, float]:
    """A finger that presses for two seconds, now here, now there, and then rests for one: place (m), radius (m), pressure (Pa)."""
    number, within = divmod(seconds, 3.0)
    x0, y0, x1, y1 = skin.domain.bounds
    share_x, share_y = 0.25 + 0.5 * (0.618034 * number % 1), 0.25 + 0.5 * (0.754878 * number % 1)
    return (x0 + share_x * (x1 - x0), y0 + share_y * (y1 - y0)), 8e-3, 20e3 if within < 2 else 0.0


def main() -> None:
    """Run one patch."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stop = threading.Event()
    settings = json.loads(sys.stdin.buffer.readline())

    def end_with_input() -> None:
        sys.stdin.buffer.read()
        stop.set()

    threading.Thread(target=end_with_input, daemon=True).start()
    loop = PatchLoop(settings, stop)
    try:
        loop.run()
    except OhmskinError as error:
        loop.tell(failed=str(error))


if __name__ == "__main__":
    main()
