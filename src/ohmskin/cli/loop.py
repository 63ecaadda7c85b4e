"""``ohmskin record``: the loop, without a page, and its recording."""

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TextIO

import ohmskin
from ohmskin.calibrate import skin_as_measured
from ohmskin.cli.options import (
    AS_THE_MODE,
    Demo,
    DeviceUrl,
    Imaging,
    ModeName,
    Seconds,
    SkinName,
    Stop,
    open_skin,
    refuse_existing,
    say,
)
from ohmskin.device import Device
from ohmskin.device.demo import demo_finger
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine, State, Touch
from ohmskin.engine.compiling import Compilation, compile_ahead
from ohmskin.engine.functions import Part
from ohmskin.engine.quiet import CalibrationReport
from ohmskin.engine.tables import prepare
from ohmskin.errors import DeviceLost, OhmskinError
from ohmskin.mcap import Progress
from ohmskin.recording.player import Player
from ohmskin.recording.recorder import Recorder
from ohmskin.sensing import mode_named
from ohmskin.skin import Skin

_REPORT_EVERY = 1.0  # s


class ProgressReport:
    """Prints rate and size of a recording once a second, and warns when it cannot be written."""

    def __init__(self, recorder: Recorder, quiet: bool) -> None:
        self._recorder, self._quiet = recorder, quiet
        self._due = time.monotonic() + _REPORT_EVERY
        self._last, self._troubled = Progress(), ""

    def __call__(self, touch: Touch) -> None:
        now = time.monotonic()
        if now < self._due:
            return
        since, self._due = now - self._due + _REPORT_EVERY, now + _REPORT_EVERY
        progress = self._recorder.progress
        if progress.trouble != self._troubled:
            self._troubled = progress.trouble
            why = f"warning: recording paused: {progress.trouble}; the loop continues"
            print(why if progress.trouble else "recording resumed", file=sys.stderr, flush=True)
        if not self._quiet:
            rate = (progress.written - self._last.written) / since
            dropped = sum(progress.dropped.values())
            counts = f"{touch.health.rate:6.0f} cycles/s  {progress.frames:8d} frames  {progress.written / 1e6:8.2f} MB"
            lost = f"  {dropped} messages dropped" if dropped else ""
            print(f"{counts}  {rate / 1e6:6.2f} MB/s{lost}", flush=True)
        self._last = progress


@dataclass(frozen=True)
class Loop:
    """An engine, who leads it if the device is a recording, who takes what it feels, who hears messages, and who is
    called with the reason while the device is lost."""

    engine: Engine
    player: Player | None
    sinks: list[Callable[[Touch], None]]
    notify: Callable[[str], None]
    lost: list[Callable[[str], None]] = field(default_factory=list)

    def run(
        self, stop: Stop, seconds: float | None, step: Callable[[], Touch | None] | None = None, demo: bool = False
    ) -> None:
        """Hand what every cycle feels to the sinks, until stopped or so many seconds are over.

        Without a `step` of its own, such as a page's, it ends with a recording, and a `demo` finger presses a virtual
        skin that was opened for this command.
        """
        stop.listen()
        played = self.player.device if self.player and step is None else None  # whose end is that of the loop
        if self.player:
            step = self.player.lead(step) if step else self.player.step
        elif step is None and demo and self.engine.device.url.startswith("virtual:"):
            self.notify("a demonstration finger presses the virtual skin (--no-demo: without it)")
            step = self._pressed()
        step = step or self.engine.step
        gc.collect()
        gc.freeze()  # a full collection of what was set up would stop the loop for many frames
        end = float("inf") if seconds is None else time.monotonic() + seconds
        while not (stop or (played and played.ended)) and time.monotonic() < end:
            if touch := step():
                for sink in self.sinks:
                    sink(touch)
            elif self.engine.state is State.LOST:
                for tell in self.lost:
                    tell(self.engine.message)

    def _pressed(self) -> Callable[[], Touch | None]:
        """Cycles while a demonstration finger wanders over the skin."""
        began = time.monotonic()

        def step() -> Touch | None:
            self.engine.press(0, *demo_finger(self.engine.skin.domain, time.monotonic() - began))
            return self.engine.step()

        return step


@contextmanager
def open_loop(
    device: str,
    skin: str,
    mode: str,
    imaging: Imaging,
    notify: Callable[[str], None],
    record: Path | None = None,
    images: float = 30.0,
    quiet: bool = False,
    out: TextIO | None = None,
    starting: Callable[[str, float | None], None] = lambda *_: None,
    at_once: bool = False,
) -> Iterator[Loop]:
    """A loop on a device, recorded if there is a file to `record` to; the options are those of `ohmskin record`.

    Messages of the engine go to `notify`, a summary of the recording to `out` at the end, standard output unless given.
    One that could not be written to its end raises OhmskinError there.
    While all goes well, a `quiet` one reports nothing of the recording. `starting` gets what is done before there is a
    loop, and which share of it. A loop without a `mode` and a recording may begin `at_once`, in another mode than the
    default one while that is compiled.
    """

    apart = at_once and not mode and record is None
    compilations: list[Compilation] = []

    def meanwhile(description: Skin) -> None:
        if apart:
            compilations.append(stack.enter_context(Compilation(description)))
            if compilations[0].under_way:
                compile_ahead(starting, Part.STANDING_IN)
        elif mode_named(description, mode).reader != "centroid":
            with Compilation():
                compile_ahead(starting)
        starting("starting the virtual skin", None)
        if not any(one.under_way for one in compilations):
            prepare(description, mode)

    def open_device() -> Device:
        found = first.pop() if first else open_skin(device, skin)[0]
        return recorder.tee(found) if recorder else found

    def report(sentence: str) -> None:
        if recorder:
            recorder.note(sentence)
        notify(sentence)

    def summarise(failed: type[BaseException] | None, *_: object) -> None:
        assert recorder is not None
        progress = recorder.close()
        summary = _summary(recorder.path, progress)
        if progress.trouble and failed is None:
            raise OhmskinError(summary)
        print(summary, file=out, flush=True)

    with ExitStack() as stack:
        opened, description = open_skin(device, skin, meanwhile=meanwhile)
        first = [opened]

        def begins(sentence: str) -> None:
            starting(sentence, None)
            notify(sentence)

        try:
            description = skin_as_measured(opened, description, ohmskin.__version__, notify, begins)
            recorder = None if record is None else Recorder(record, description, images)
        except BaseException:
            opened.close()
            raise
        if recorder:
            stack.push(summarise)
        if apart and not compilations and not isinstance(opened, ReplayDevice):
            compilations.append(stack.enter_context(Compilation(description)))
        engine = stack.enter_context(Engine(open_device, description, mode, report, *compilations, **asdict(imaging)))
        if recorder:
            recorder.watch(engine)
        player = Player(engine, mode, notify) if isinstance(opened, ReplayDevice) else None
        sinks: list[Callable[[Touch], None]] = [recorder.publish, ProgressReport(recorder, quiet)] if recorder else []
        yield Loop(engine, player, sinks, notify)


def _summary(file: Path, progress: Progress) -> str:
    """The outcome of a recording, in a sentence."""
    if not file.exists():
        return f"no frame was recorded; {file} was not written"
    lost = ", ".join(f"{count} of {topic}" for topic, count in progress.dropped.items())
    return (
        f"{file}: {progress.frames} frames, {progress.written / 1e6:.2f} MB"
        + (f"; dropped {lost}" if lost else "")
        + (f"; {progress.trouble}: `ohmskin recover {file}` repairs it" if progress.trouble else "")
    )


def calibrating(device: str) -> str:
    """What happens before the loop senses, for the device of an address."""
    if device.startswith("replay:"):
        return "reading the calibration of the recording"
    return "calibrating: keep the skin untouched"


def record(
    file: Path,
    *,
    device: DeviceUrl = "virtual:",
    skin: SkinName = "",
    mode: ModeName = "",
    imaging: Imaging = AS_THE_MODE,
    seconds: Seconds = None,
    images: float = 30.0,
    demo: Demo = True,
) -> None:
    """Record a device: raw frames with the patterns really driven, calibration, contacts, images and health, as MCAP.

    Args:
        file: The recording, such as touch.mcap; an existing file is never overwritten.
        images: Largest number of images per second (1/s); images can be recomputed from the frames.
    """
    refuse_existing(file)
    stop = Stop()
    with open_loop(device, skin, mode, imaging, say, file, images) as loop:
        say(f"{loop.engine.mode.label}; {calibrating(device)}")
        with suppress(DeviceLost):  # the loop reconnects
            loop.engine.calibrate(CalibrationReport(lambda sentence, *_: say(sentence)))
        say(f"recording to {file}   (Ctrl-C ends)")
        loop.run(stop, seconds, demo=demo)
