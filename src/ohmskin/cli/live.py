"""``ohmskin live``: the whole loop, in the browser or on the terminal."""

import gc
import json as json_module
import signal
import sys
import time
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TextIO

from cyclopts import Parameter

from ohmskin.cli.options import AS_THE_MODE, Imaging, check_seconds, has_display, open_skin, say
from ohmskin.cli.recording import ProgressReport, refuse_existing, reopening, reporting, summary
from ohmskin.client import Patch
from ohmskin.client.fields import as_json
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine, Touch
from ohmskin.outlets.publisher import Publisher
from ohmskin.recording.player import Player
from ohmskin.recording.recorder import Recorder
from ohmskin.view.session import Session

_ROWS_PER_SECOND = 5
_GONE_AFTER = 1.0  # s; longer than a contact goes unseen and keeps its id


def live(
    *,
    device: str = "virtual:",
    skin: str = "",
    mode: str = "",
    imaging: Imaging = AS_THE_MODE,
    host: str = "127.0.0.1",
    port: int = 8000,
    token: str = "",
    demo: bool = True,
    browser: bool = True,
    headless: bool = False,
    json: bool = False,
    seconds: float | None = None,
    record: Path | None = None,
    publish: Annotated[tuple[str, ...], Parameter(consume_multiple=False)] = (),
    name: str = "skin",
    frame: str = "skin",
    newtons: float | None = None,
) -> None:
    """Sense touches, live: a page in the browser, or contacts on the terminal.

    Args:
        device: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE.
        skin: A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.
        mode: A mode of the skin, such as 16P or 12B (`ohmskin info` lists them); the most precise one unless given.
        host: Address to serve the page at; one that others can reach needs a token.
        port: Port of the page; if it is taken, the next free one.
        token: Password, a part of the page's address.
        demo: Let a demonstration finger wander over a virtual skin until somebody presses.
        browser: Open the page in a browser if there is a display.
        headless: No page: contacts as a table on the terminal.
        json: No page: a line of JSON for every frame.
        seconds: End after so many seconds.
        record: Record everything to this file, such as touch.mcap; see docs/guide/recording.md.
        publish: Publish what is felt to shm, zenoh[:PLACE], dds[:INTERFACE] or foxglove[:HOST:PORT]; may be repeated.
        name: What clients call this skin, and what its topics begin with.
        frame: The frame of published contacts: a link of the robot.
        newtons: Newtons per m2 of contact strength, if you have calibrated that; wrenches are published with it only.
    """
    check_seconds(seconds)
    if record is not None:
        refuse_existing(record)
    stop = Stop()
    tell = say if not json else lambda _: None
    opened, description = open_skin(device, skin)
    recorder = Recorder(record, description) if record is not None else None
    source = reopening(opened, device, skin, recorder), description, mode, reporting(recorder, tell)
    with ExitStack() as stack:
        if recorder:
            stack.callback(_sum_up, recorder, sys.stderr if json else sys.stdout)
        engine = stack.enter_context(Engine(*source, **asdict(imaging)))
        player = Player(engine, mode, tell) if isinstance(opened, ReplayDevice) else None
        sinks: list[Callable[[Touch], None]] = []
        if recorder:
            recorder.watch(engine)
            sinks += [recorder.publish, ProgressReport(recorder, quiet=True)]
        if publish:
            publisher = Publisher(description, publish, name, Patch(name, frame), newtons, token or None)
            stack.enter_context(publisher)
            sinks.insert(0, publisher.publish)  # first, because robots wait for it
            tell(f"publishing at {', '.join(publisher.addresses)}")
        if headless or json:
            tell(f"{engine.mode.label}; calibrating: keep the skin untouched")
            engine.calibrate()
            ended = player.until(stop) if player else stop
            run(player.step if player else engine.step, ended, seconds, *sinks, _print_json if json else _Table())
            return
        with Session(engine, device, host, port, token or None, demo) as session:
            if session.view.port_was_taken:
                say(f"port {port} is in use; taking the next free one")
            say(f"open {session.view.url}   (Ctrl-C ends)")
            if address := getattr(opened, "address", ""):
                say(f"press from another terminal: ohmskin press 50 120 --device {address}")
            if browser and has_display():
                webbrowser.open(session.view.url)
            say(f"{engine.mode.label}; calibrating: keep the skin untouched")
            session.calibrate()
            run(player.lead(session.step) if player else session.step, stop, seconds, *sinks, _Arrivals())


class Stop:
    """True once Ctrl-C or SIGTERM has come."""

    def __init__(self) -> None:
        self._asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, *_: object) -> None:
        if self._asked:  # asked twice: leave at once
            raise KeyboardInterrupt
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked


def _sum_up(recorder: Recorder, where: TextIO) -> None:
    print(summary(recorder.path, recorder.close()), file=where, flush=True)


def run(step: Callable[[], Touch | None], stop: object, seconds: float | None, *sinks: Callable[[Touch], None]) -> None:
    """Hand what every cycle feels to the sinks, until told to stop or so many seconds are over."""
    gc.collect()
    gc.freeze()  # a full collection of what was set up would stop the loop for many frames
    end = float("inf") if seconds is None else time.monotonic() + seconds
    while not stop and time.monotonic() < end:
        if touch := step():
            for sink in sinks:
                sink(touch)


class _Arrivals:
    """A line for every contact that comes."""

    def __init__(self) -> None:
        self._last: dict[int, float] = {}  # when each was seen last; ids are counted anew after a calibration

    def __call__(self, touch: Touch) -> None:
        self._last = {number: seen for number, seen in self._last.items() if touch.time - seen < _GONE_AFTER}
        for contact in touch.contacts:
            if contact.id not in self._last:
                x, y = contact.position
                say(f"contact {contact.id} at ({x * 1e3:.0f}, {y * 1e3:.0f}) mm, {contact.extent * 1e4:.1f} cm2")
            self._last[contact.id] = touch.time


class _Table:
    """A row per contact, a few times a second; a row of dashes while nothing is touched."""

    def __init__(self) -> None:
        self._due = 0.0
        print("    time  frames/s  latency  id    x/mm    y/mm  extent/cm2  strength/cm2  confidence")

    def __call__(self, touch: Touch) -> None:
        if touch.time < self._due:
            return
        self._due = max(self._due + 1 / _ROWS_PER_SECOND, touch.time)
        health = touch.health
        start = f"{time.strftime('%H:%M:%S')}  {health.rate:8.0f}  {health.latency_p50 * 1e3:4.1f} ms"
        for c in touch.contacts:
            x, y = c.position
            place = f"{x * 1e3:6.1f}  {y * 1e3:6.1f}"
            size = f"{c.extent * 1e4:10.1f}  {c.strength * 1e4:12.2f}"
            print(f"{start}  {c.id:2d}  {place}  {size}  {c.confidence:10.3f}")
        if not touch.contacts:
            print(f"{start}   -       -       -           -             -           -")
        sys.stdout.flush()


def _print_json(touch: Touch) -> None:
    line = {
        "sequence": touch.sequence,
        "time": touch.time,
        "mode": touch.mode.name,
        "contacts": [as_json(contact) for contact in touch.contacts],
        **touch.health.figures,
    }
    print(json_module.dumps(line), flush=True)
