"""What commands that record say."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

from ohmskin.cli.options import open_skin
from ohmskin.device import Device
from ohmskin.engine import Touch
from ohmskin.errors import OhmskinError
from ohmskin.mcap import Progress
from ohmskin.recording.recorder import Recorder

_REPORT_EVERY = 1.0  # s


class ProgressReport:
    """Says how a recording goes, once a second, and warns when something stands in its way."""

    def __init__(self, recorder: Recorder, quiet: bool = False) -> None:
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
            why = f"warning: the recording stands still: {progress.trouble}; the loop goes on"
            print(why if progress.trouble else "the recording goes on", file=sys.stderr, flush=True)
        if not self._quiet:
            rate = (progress.written - self._last.written) / since
            dropped = sum(progress.dropped.values())
            counts = f"{touch.health.rate:6.0f} cycles/s  {progress.frames:8d} frames  {progress.written / 1e6:8.2f} MB"
            lost = f"  {dropped} messages dropped" if dropped else ""
            print(f"{counts}  {rate / 1e6:6.2f} MB/s{lost}", flush=True)
        self._last = progress


def reopening(opened: Device, device: str, skin: str, recorder: Recorder | None) -> Callable[[], Device]:
    """What opens a device for an engine: the one that is open, later the address anew. A recorder listens to each."""
    first = [opened]

    def open_device() -> Device:
        found = first.pop() if first else open_skin(device, skin)[0]
        return recorder.tee(found) if recorder else found

    return open_device


def reporting(recorder: Recorder | None, tell: Callable[[str], None]) -> Callable[[str], None]:
    """What takes the sentences of an engine, which are recorded, too."""

    def report(sentence: str) -> None:
        if recorder:
            recorder.note(sentence)
        tell(sentence)

    return report


def refuse_existing(file: Path) -> None:
    """Raise unless a recording can be made here; asked before the device is opened, which takes a while."""
    if file.exists():
        raise OhmskinError(f"{file} exists, and a recording is never overwritten; choose another name")
    if not file.absolute().parent.is_dir():
        raise OhmskinError(f"cannot record to {file}: there is no folder {file.absolute().parent}; make it first")


def summary(file: Path, progress: Progress) -> str:
    """What became of a recording, in a sentence."""
    if not file.exists():
        return f"nothing was recorded; there is no {file}"
    lost = ", ".join(f"{count} of {topic}" for topic, count in progress.dropped.items())
    return (
        f"{file}: {progress.frames} frames, {progress.written / 1e6:.2f} MB"
        + (f"; dropped {lost}" if lost else "")
        + (f"; {progress.trouble}: `ohmskin recover {file}` mends what is there" if progress.trouble else "")
    )
