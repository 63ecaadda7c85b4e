"""The recorder: a sink that keeps everything the loop measured and detected, in a file that others can read."""

import os
import platform
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

import ohmskin
from ohmskin.client.contacts import Patch
from ohmskin.closing import Closing
from ohmskin.contacts import in_frame
from ohmskin.device import Device
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import DataError
from ohmskin.geometry import Raster
from ohmskin.mcap import Progress, Role, WriterPipe, messages, standard
from ohmskin.mcap.modes import encode_modes
from ohmskin.mcap.reader import FORMAT
from ohmskin.mcap.schemas import FRAME, HEALTH, IMAGE, LOG, MARKERS, PATTERN, TOUCH
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import drive_of
from ohmskin.sensing import modes as modes_of
from ohmskin.skin import Mode, Skin

PIXELS = 64
"""Pixels of a recorded image along the skin's longer side; those of the live page."""

_SHEET = Patch("contacts")  # in its own frame; the name tells its markers from others
_MOST_PATTERNS = 4096  # remembered as stored; one that was forgotten is stored again
_HEALTH_EVERY = 1.0  # s


class Recorder(Closing):
    """Records a device and, if there is one, the loop that runs on it, without waiting for the disk.

        with Recorder("touch.mcap", skin) as recorder:
            with Engine(lambda: recorder.tee(connect(url)), skin, report=recorder.note) as engine:
                recorder.watch(engine)
                engine.calibrate()
                for touch in engine.touches():
                    recorder.publish(touch)

    Args:
        path: The recording, a file that is not there yet.
        skin: What the device is.
        images: Most images and markers per second; they can be computed again from the frames. 0 for none, infinity for
            all.
        modes: The modes that may be used, so that a replay can use them; those of the skin unless given.

    Raises:
        DataError: If the file is there already or cannot be made.
    """

    def __init__(self, path: str | Path, skin: Skin, images: float = 30.0, modes: Iterable[Mode] = ()) -> None:
        if not images >= 0:
            raise DataError(f"images is {images} per second; it must be 0 or more")
        self._chart = skin.chart
        used = tuple(modes) or tuple(modes_of(skin).values())
        told = {mode.name: {**mode.entries, "adjustable": drive_of(mode, skin).adjustable} for mode in used}
        self.skin, self._modes = skin, encode_modes(told)
        self.path = Path(path)
        self._pipe: WriterPipe | None = None
        self._engine: Engine | None = None
        if os.path.exists(self.path):
            raise DataError(f"{self.path} exists, and a recording is never overwritten; choose another name")
        self._named: dict[int, DrivePattern] = {}  # the newest stored pattern of each digest
        self._raster: Raster | None = None
        self._image_every, self._image_at, self._health_at = (1 / images if images else np.inf), -np.inf, -np.inf
        self._frames, self._unnamed, self._ended = 0, 0, Progress()

    def tee(self, device: Device) -> Device:
        """The same `device`, whose frames are recorded. The first device is described in the file.

        Raises:
            DataError: If the file cannot be made.
        """
        if self._pipe is None:
            self._open(device)
            for frame in device.reference:
                self.frame(frame, Role.QUIET)
        device.listen(self.frame)
        return device

    def watch(self, engine: Engine) -> None:
        """Get the purpose of each frame from this engine, so that a replay can calibrate with the same frames."""
        self._engine = engine

    def frame(self, frame: Frame, role: Role | None = None) -> None:
        """Record one frame; `tee` calls it.

        Args:
            frame: The frame.
            role: Purpose of its scan; unless given, that from the engine of `watch`, if there is one.

        Raises:
            DataError: If no device was opened with `tee`.
        """
        if self._pipe is None:
            raise DataError("this recorder has no device yet; open one with recorder.tee(device)")
        stamp, mode = time.time_ns(), ""
        if self._engine is not None:
            mode = self._engine.mode.name
            if role is None:
                first = self._engine.scans_made == 0
                role = Role.QUIET if self._engine.state is State.CALIBRATING else Role.BASE if first else Role.CHOSEN
        self._frames += 1
        if self._store(frame.pattern, stamp):
            data = messages.encode_frame(frame, stamp, time.monotonic(), role or Role.UNKNOWN, mode)
            self._pipe.send(FRAME, self._frames, stamp, data)
        else:
            self._unnamed += 1

    def publish(self, touch: Touch) -> None:
        """Record a `touch`: its contacts, and an image and the loop's health as often as they are due."""
        if self._pipe is None:
            return
        stamp, number = time.time_ns(), touch.sequence
        frames = [frame.sequence & 0xFFFFFFFFFFFFFFFF for frame in touch.percept.frames]
        data = messages.encode_touch(number, touch.time, stamp, touch.mode.name, frames, touch.contacts)
        self._pipe.send(TOUCH, number, stamp, data)
        clock = time.monotonic()
        if self._raster is not None and clock >= self._image_at:
            self._image_at = clock + self._image_every
            pixels = self._raster(touch.percept.image.values)
            self._pipe.send(IMAGE, number, stamp, standard.encode_image(pixels, stamp))
            contacts = in_frame(touch.contacts, self._chart, _SHEET)
            self._pipe.send(MARKERS, number, stamp, standard.encode_markers(contacts, (_SHEET,), stamp))
        if clock >= self._health_at:
            self._health_at = clock + _HEALTH_EVERY
            values = touch.health.diagnostics | {"recorder_dropped": sum(self.progress.dropped.values())}
            message = self._engine.message if self._engine is not None else ""
            self._pipe.send(HEALTH, number, stamp, standard.encode_health(values, message, self._device, stamp))

    def note(self, sentence: str) -> None:
        """Record a sentence of the loop."""
        if self._pipe is not None:
            stamp = time.time_ns()
            self._pipe.send(LOG, 0, stamp, standard.encode_log(sentence, stamp))

    @property
    def progress(self) -> Progress:
        """What was written and dropped, and the reason if nothing can be written now."""
        if self._pipe is None:
            return self._ended
        progress = self._pipe.progress
        if self._unnamed:
            return replace(progress, dropped={**progress.dropped, "frames without their pattern": self._unnamed})
        return progress

    def close(self) -> Progress:
        """Finish the file, and return its last `progress`; one without any frame is deleted. Safe to call twice."""
        if self._pipe is not None:
            self._pipe.close()
            self._ended, self._pipe = self.progress, None
            if not self._frames:
                self.path.unlink(missing_ok=True)
        return self._ended

    def _open(self, device: Device) -> None:
        self._device = device.capabilities.name
        metadata = {
            "ohmskin": {
                "format": FORMAT,
                "ohmskin": ohmskin.__version__,
                "numpy": np.__version__,
                "scipy": scipy.__version__,
                "python": platform.python_version(),
                "platform": platform.platform(),
                "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "skin": self.skin.name,
                "modes": self._modes,
            },
            "device": {**device.capabilities.as_texts(), "reference": str(len(device.reference))},
        }
        if self._image_every < np.inf:
            self._raster = raster = Raster(self.skin.mesh(), PIXELS)
            corner = {"x0": repr(float(raster.x[0])), "y0": repr(float(raster.y[0])), "pitch": repr(raster.pitch)}
            metadata["raster"] = {**corner, "nx": str(len(raster.x)), "ny": str(len(raster.y)), "unit": "1"}
        self._pipe = WriterPipe(self.path, metadata, {"skin.toml": self.skin.dump()})

    def _store(self, pattern: DrivePattern, stamp: int) -> bool:
        """See to it that the newest pattern in the file with this digest is this one."""
        assert self._pipe is not None
        stored = self._named.get(pattern.digest)
        known = stored is pattern or stored == pattern
        if not known and not self._pipe.send(PATTERN, 0, stamp, messages.encode_pattern(pattern)):
            return False
        self._named[pattern.digest] = pattern
        if len(self._named) > _MOST_PATTERNS:
            del self._named[next(iter(self._named))]
        return True
