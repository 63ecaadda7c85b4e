"""The process of one patch: its loop and its boards.

`ohmskin.body.patches` starts it; it ends with its standard input.
"""

import gc
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import ohmskin
from ohmskin.calibrate import skin_as_measured
from ohmskin.child import begin, when_input_ends
from ohmskin.client.board import Board
from ohmskin.client.contacts import patches_from
from ohmskin.compiler import take_turns
from ohmskin.device import Device, connect
from ohmskin.device.demo import demo_finger
from ohmskin.engine import Engine, State
from ohmskin.engine.compiling import compile_ahead
from ohmskin.engine.functions import Part
from ohmskin.engine.quiet import CalibrationReport
from ohmskin.errors import DeviceError, OhmskinError
from ohmskin.outlets.commands import CommandServer
from ohmskin.outlets.publisher import Publisher
from ohmskin.sensing import mode_named
from ohmskin.skin import Skin

_RETRY_AFTER = 1.0
_REPORT_EVERY = 0.5
_PRESS_EVERY = 1 / 30  # s: a press takes a virtual skin as long as ten scans


def sense(settings: dict[str, Any], answer: Callable[..., None], stop: threading.Event) -> None:
    """Sense with one patch until it is stopped; when the device cannot be reached, say so and try again.

    Args:
        settings: `device`, `skin` (TOML), `mode`, `patch`, `name` of its boards, most `images` per second, and whether
            a demonstration finger presses it (`demo`).
        answer: Takes how it goes, by keyword; called without any when there is something new on its boards.
        stop: Set to end.
    """
    skin, device = Skin.parse(settings["skin"]), settings["device"]
    (patch,) = patches_from({"patches": [settings["patch"]]})
    part = Part.WITHOUT_FITS if mode_named(skin, settings["mode"]).reader == "centroid" else Part.ALL

    def say(sentence: str) -> None:
        answer(message=sentence)

    ahead = partial(compile_ahead, lambda sentence, _: say(sentence), part)
    first = list[Device]()  # is there already when an engine opens it

    def opened() -> Device:
        if first:
            return first.pop()
        if device == "virtual:":
            return connect(device, skin=skin, meanwhile=ahead)
        ahead()
        return connect(device)

    with (
        Publisher(skin, (), settings["name"], patch, images=settings["images"]) as publisher,
        Board(f"{settings['name']}.device", {}, 256) as address,
    ):
        while not stop.is_set():
            try:
                first.append(opened())
                fitted = skin_as_measured(first[0], skin, ohmskin.__version__, say, say)
                publisher.fit(fitted)
                with Engine(opened, fitted, settings["mode"], say) as engine:
                    commands = dict[str, Callable[..., None]](tare=engine.calibrate, set_mode=engine.set_mode)
                    with CommandServer(settings["name"], commands) as server:
                        _run(engine, publisher, server, address, skin if settings["demo"] else None, answer, stop)
            except DeviceError as error:
                answer(state="lost", message=str(error))
                publisher.lost(str(error))
                stop.wait(_RETRY_AFTER)


def _run(
    engine: Engine,
    publisher: Publisher,
    server: CommandServer,
    address: Board,
    pressed: Skin | None,
    answer: Callable[..., None],
    stop: threading.Event,
) -> None:
    """Calibrate and sense; a demonstration finger wanders over the skin that is `pressed`."""
    report = CalibrationReport(lambda sentence, *_: answer(message=sentence))

    def go_on(progress: float) -> None:
        if stop.is_set():
            raise SystemExit
        report(progress)

    answer(state="calibrating", message="")
    engine.calibrate(go_on)
    gc.collect()
    gc.freeze()
    due, press_at, began = 0.0, 0.0, time.monotonic()
    while not stop.is_set():
        if pressed and engine.state is State.RUNNING and (now := time.monotonic()) >= press_at:
            press_at = now + _PRESS_EVERY
            engine.press(0, *demo_finger(pressed.domain, now - began))
        touch = engine.step()
        if touch is not None:
            publisher.publish(touch)
            answer()
            server.poll()
        elif engine.state is State.LOST:
            publisher.lost(engine.message)
            server.poll(engine.message)
        if (now := time.monotonic()) >= due:
            due = now + _REPORT_EVERY
            address.write(getattr(engine.device, "address", "").encode())  # where a page presses a virtual skin
            health = touch.health if touch is not None else None
            figures = health and {"rate": health.rate, "p50": health.latency_p50, "p99": health.latency_p99}
            answer(state=engine.state.value, **(figures or {}))


def main() -> None:
    """Run one patch."""
    take_turns()
    settings, answer = begin(waits=False)
    stop = threading.Event()
    when_input_ends(stop.set)
    try:
        sense(settings, answer, stop)
    except OhmskinError as error:
        answer(failed=str(error))


if __name__ == "__main__":
    main()
