"""``ohmskin live``: the whole loop, in the browser or on the terminal."""

import json as json_module
import sys
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from ohmskin.cli.arrivals import Arrivals
from ohmskin.cli.loop import calibrating, open_loop
from ohmskin.cli.options import (
    AS_THE_MODE,
    HERE,
    Demo,
    DeviceUrl,
    Flag,
    Imaging,
    ModeName,
    Page,
    Repeated,
    Seconds,
    SkinName,
    Stop,
    check_publishing,
    check_source,
    refuse_existing,
    refuse_unused,
    say,
)
from ohmskin.client import Patch
from ohmskin.client.fields import as_json
from ohmskin.closing import Closing
from ohmskin.engine import Engine, State, Touch
from ohmskin.engine.quiet import CalibrationReport
from ohmskin.errors import DeviceLost, ViewError
from ohmskin.outlets.commands import CommandServer
from ohmskin.outlets.publisher import Publisher
from ohmskin.view.live import LiveView
from ohmskin.view.session import PageSession

_ROWS_PER_SECOND = 5
_NO_FRAME: dict[str, Any] = {"sequence": None, "contacts": []}


def live(
    *,
    device: DeviceUrl = "virtual:",
    skin: SkinName = "",
    mode: ModeName = "",
    imaging: Imaging = AS_THE_MODE,
    page: Page = HERE,
    demo: Demo = True,
    headless: Flag = False,
    json: Flag = False,
    seconds: Seconds = None,
    record: Path | None = None,
    publish: Repeated = (),
    name: str = "skin",
    frame: str = "skin",
) -> None:
    """Sense touches, live: a page in the browser, or contacts on the terminal.

    Args:
        headless: No page: contacts as a table on the terminal.
        json: No page: a line of JSON for every frame, with state and messages; while it calibrates, or the device is
            lost, for messages.
        record: Record everything to this file, such as touch.mcap; see docs/guide/recording.md.
        publish: Publish contacts to shm, zenoh[:PLACE], dds[:INTERFACE], foxglove[:HOST:PORT] or
            mcap:FILE; may be repeated.
        name: Name of this skin for clients; its topics begin with it.
        frame: Frame of the published contacts: a link of the robot.
    """
    if record is not None:
        refuse_existing(record)
    if publish:
        check_publishing(publish, page, name)
    page.check("--headless" if headless else "--json" if json else "", bool(publish))
    if not publish:
        refuse_unused("without --publish", name=name != "skin", frame=frame != "skin")
    check_source(device, skin, mode)
    stop = Stop()
    lines = _Lines(calibrates=not device.startswith("replay:"))
    notify = lines.notify if json else say
    out = sys.stderr if json else sys.stdout
    with ExitStack() as stack:
        opening = None if headless or json else stack.enter_context(_Opening(page))
        starting = opening.starting if opening else lambda *_: None
        loop = stack.enter_context(
            open_loop(
                device, skin, mode, imaging, notify, record, quiet=True, out=out, starting=starting, at_once=not publish
            )
        )
        engine = lines.engine = loop.engine
        report = CalibrationReport(lines.calibrating if json else lambda sentence, *_: say(sentence))
        commands = dict[str, Callable[..., None]](tare=partial(engine.calibrate, report), set_mode=engine.set_mode)
        if publish:
            publisher = Publisher(engine.skin, publish, name, Patch(name, frame), page.token or None)
            stack.enter_context(publisher)
            loop.sinks.insert(0, publisher.publish)  # first, because robots wait for it
            server = stack.enter_context(CommandServer(name, commands))
            loop.sinks.append(lambda touch: server.poll())
            loop.lost.extend([publisher.lost, server.poll])
            notify(f"publishing at {', '.join(publisher.addresses)}")
        if opening is None:
            notify(f"{engine.mode.label}; {calibrating(device)}")
            with suppress(DeviceLost):  # the loop reconnects
                engine.calibrate(report)
            loop.sinks.append(lines if json else _Table())
            loop.run(stop, seconds, demo=demo)
            return
        with PageSession(engine, device, opening.view, demo) as session:
            if address := getattr(engine.device, "address", ""):
                say(f"press from another terminal: ohmskin press 50 120 --device {address}")
            say(f"{engine.mode.label}; {calibrating(device)}")
            with suppress(DeviceLost):
                session.calibrate()
            commands["tare"] = session.calibrate
            loop.sinks.append(_Arrivals())
            loop.run(stop, seconds, session.step)


class _Opening(Closing):
    """A page that opens in a thread, so that the device starts meanwhile."""

    def __init__(self, page: Page) -> None:
        self._said: tuple[str, float | None] = "starting", None
        self._pool = ThreadPoolExecutor(1)
        self._view = self._pool.submit(self._open, page)

    def _open(self, page: Page) -> LiveView:
        view = LiveView(None, *page.address)
        if view.port_was_taken:
            say(f"port {page.port} is in use; taking the next free one")
        page.open(view.url)
        view.starting(*self._said)
        return view

    @property
    def view(self) -> LiveView:
        """The page; awaited."""
        return self._view.result()

    def starting(self, words: str, share: float | None) -> None:
        """Show what is done before there is a loop, and which share of it."""
        self._said = words, share
        if self._view.done():
            self.view.starting(words, share)

    def close(self) -> None:
        """Close the page. Safe to call twice."""
        with suppress(ViewError):  # it has been told
            self.view.close()
        self._pool.shutdown()


class _Arrivals:
    """A line for every contact that comes."""

    def __init__(self) -> None:
        self._arrivals = Arrivals()

    def __call__(self, touch: Touch) -> None:
        for contact in self._arrivals.new(touch.time, {contact.id: contact for contact in touch.contacts}):
            x, y = contact.position
            say(f"contact {contact.id} at ({x * 1e3:.0f}, {y * 1e3:.0f}) mm, {contact.extent * 1e4:.1f} cm2")


class _Table:
    """A row per contact, a few times a second; a row of dashes while nothing is touched."""

    def __init__(self) -> None:
        self._due = 0.0
        print("    time  frames/s  latency  id    x/mm    y/mm  extent/cm2  strength/cm2  confidence         force/N")

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
            force = "-" if c.force is None else f"{c.force:.1f} ± {c.force_std:.1f}"
            print(f"{start}  {c.id:2d}  {place}  {size}  {c.confidence:10.3f}  {force:>14}")
        if not touch.contacts:
            print(f"{start}   -       -       -           -             -           -               -")
        sys.stdout.flush()


class _Lines:
    """A line of JSON for every frame, with what was said since the last one; while there is none, one for what is said.

    Args:
        calibrates: Whether a calibration is measured, which takes a while.

    Attributes:
        engine: The loop, once there is one.
    """

    def __init__(self, calibrates: bool) -> None:
        self._without_frames = {State.LOST} if not calibrates else {*State} - {State.RUNNING}
        self.engine: Engine | None = None
        self._said: deque[str] = deque(maxlen=100)

    def notify(self, sentence: str) -> None:
        """Say a sentence in the next line; at once if the device is lost or the loop calibrates."""
        self._said.append(sentence)
        if self.engine is not None and self.engine.state in self._without_frames:
            self._print(_NO_FRAME)

    def calibrating(self, sentence: str, share: float, left: float) -> None:
        """Say at once which share of the quiet skin is measured (0 to 1), and how long the rest takes (s)."""
        self._said.append(sentence)
        self._print({**_NO_FRAME, "calibrated": share, "left": left})

    def __call__(self, touch: Touch) -> None:
        contacts = [as_json(contact) for contact in touch.contacts]
        findings = [finding.words for finding in touch.percept.findings]
        line = {"sequence": touch.sequence, "time": touch.time, "mode": touch.mode.name, "contacts": contacts}
        gesture = None if touch.gesture is None else touch.gesture.as_json()
        felt = {"total_force": touch.percept.total_force, "gesture": gesture, "findings": findings}
        self._print(line | felt | touch.health.figures)

    def _print(self, line: dict[str, Any]) -> None:
        assert self.engine is not None
        told = {"state": self.engine.state.value, "messages": list(self._said)}
        self._said.clear()
        print(json_module.dumps(line | told), flush=True)
