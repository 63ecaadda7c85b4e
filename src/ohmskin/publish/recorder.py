"""The recorder: a sink that keeps everything the loop measured and felt, in a file that others can read."""

import platform
import time
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import scipy

import ohmskin
from ohmskin.device import Device
from ohmskin.device.tee import TeeDevice
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import DataError
from ohmskin.geometry import Raster
from ohmskin.record import Progress, Role, WriterPipe
from ohmskin.record.messages import (
    encode_frame,
    encode_health,
    encode_image,
    encode_log,
    encode_markers,
    encode_pattern,
    encode_touch,
)
from ohmskin.record.schemas import FRAME, HEALTH, IMAGE, LOG, MARKERS, PATTERN, TOUCH
from ohmskin.record.tape import FORMAT
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Skin

PIXELS = 64
"""Pixels of a recorded image along the skin's longer side; those of the live page."""

_MOST_PATTERNS = 4096  # remembered as stored; one that was forgotten is stored again
_HEALTH_EVERY = 1.0  # s


class Recorder:
    """Records a device and, if there is one, the loop that runs on it. Nothing here waits for the disk.

        with Recorder("touch.mcap", skin) as recorder:
            with Engine(lambda: recorder.tee(connect(url)), skin, report=recorder.note) as engine:
                recorder.watch(engine)
                engine.calibrate()
                for touch in engine.touches():
                    recorder.publish(touch)

    Args:
        path: The recording, a file that is not there yet.
        skin: What the device is.
        images: Most images and markers per second; they can be made again from the frames. 0 for none, infinity for all.

    Raises:
        DataError: If the file is there already or cannot be made.
    """

    def __init__(self, path: str | Path, skin: Skin, images: float = 30.0) -> None:
        if not images >= 0:
            raise DataError(f"images is {images} per second; it must be 0 or more")
        self.skin = skin
        self.path = Path(path)
        self._pipe: WriterPipe | None = None
        self._engine: Engine | None = None
        if self.path.exists():
            raise DataError(f"{self.path} exists, and a recording is never overwritten; choose another name")
        self._named: dict[int, DrivePattern] = {}  # the newest stored pattern of each digest
        self._raster: Raster | None = None
        self._image_every, self._image_at, self._health_at = (1 / images if images else np.inf), -np.inf, -np.inf
        self._frames, self._unnamed, self._ended = 0, 0, Progress()

    def tee(self, device: Device) -> Device:
        """The device, its frames recorded on their way. The first one is described in the file."""
        if self._pipe is None:
            self._open(device)
            for frame in device.reference:
                self.frame(frame, Role.QUIET)
        return TeeDevice(device, self.frame)

    def watch(self, engine: Engine) -> None:
        """Ask this engine what a frame is scanned for, so that a replay can calibrate with the very same frames."""
        self._engine = engine

    def frame(self, frame: Frame, role: Role | None = None) -> None:
        """Record one frame; `tee` calls it."""
        if self._pipe is None:
            raise DataError("this recorder has no device yet; open one with recorder.tee(device)")
        stamp, mode = time.time_ns(), ""
        if self._engine is not None:
            mode = self._engine.mode.name
            if role is None:
                base = self._engine.mode.base
                first = frame.pattern is base or frame.pattern == base
                role = Role.QUIET if self._engine.state is State.CALIBRATING else Role.BASE if first else Role.CHOSEN
        self._frames += 1
        if self._store(frame.pattern, stamp):
            data = encode_frame(frame, stamp, time.monotonic(), role or Role.UNTOLD, mode)
            self._pipe.send(FRAME, self._frames, stamp, data)
        else:
            self._unnamed += 1

    def publish(self, touch: Touch) -> None:
        """Record what a cycle felt: contacts, an image and the loop's health as often as they are due."""
        if self._pipe is None:
            return
        stamp, number = time.time_ns(), touch.sequence
        frames = [frame.sequence & 0xFFFFFFFFFFFFFFFF for frame in touch.sight.frames]
        data = encode_touch(number, touch.time, stamp, touch.mode.name, frames, touch.contacts)
        self._pipe.send(TOUCH, number, stamp, data)
        clock = time.monotonic()
        if self._raster is not None and clock >= self._image_at:
            self._image_at = clock + self._image_every
            self._pipe.send(IMAGE, number, stamp, encode_image(self._raster(touch.sight.image.values), stamp))
            self._pipe.send(MARKERS, number, stamp, encode_markers(touch.contacts, stamp))
        if clock >= self._health_at:
            self._health_at = clock + _HEALTH_EVERY
            health = touch.health
            values = {name: float(value) for name, value in vars(health).items() if isinstance(value, int | float)}
            values["recorder_dropped"] = float(sum(self.progress.dropped.values()))
            message = self._engine.message if self._engine is not None else ""
            self._pipe.send(HEALTH, number, stamp, encode_health(values, message, self._device, stamp))

    def note(self, sentence: str) -> None:
        """Record a sentence of the loop."""
        if self._pipe is not None:
            stamp = time.time_ns()
            self._pipe.send(LOG, 0, stamp, encode_log(sentence, stamp))

    @property
    def progress(self) -> Progress:
        """How much was written and dropped, and what stands in the way."""
        if self._pipe is None:
            return self._ended
        progress = self._pipe.progress
        if self._unnamed:
            return replace(progress, dropped={**progress.dropped, "frames without room for their pattern": self._unnamed})
        return progress

    def close(self) -> Progress:
        """Finish the file and say how it went; a file without a single frame is taken away again. Safe twice."""
        if self._pipe is not None:
            self._pipe.close()
            self._ended, self._pipe = self.progress, None
            if not self._frames:
                self.path.unlink(missing_ok=True)
        return self._ended

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, device: Device) -> None:
        able = device.capabilities
        self._device = able.name
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
            },
            "device": {
                "name": able.name,
                "n_electrodes": str(able.n_electrodes),
                "max_injections": str(able.max_injections),
                "max_measurements": str(able.max_measurements),
                "features": str(int(able.features)),
                "excitation": repr(able.excitation),
                "full_scale": repr(able.full_scale),
                "settle_time": repr(able.settle_time),
                "conversion_time": repr(able.conversion_time),
                "serial": str(able.serial),
                "reference": str(len(device.reference)),
            },
        }
        if self._image_every < np.inf:
            self._raster = raster = Raster(self.skin.mesh(), PIXELS)
            metadata["raster"] = {
                "x0": repr(float(raster.x[0])),
                "y0": repr(float(raster.y[0])),
                "pitch": repr(raster.pitch),
                "nx": str(len(raster.x)),
                "ny": str(len(raster.y)),
                "unit": "1",
            }
        self._pipe = WriterPipe(self.path, metadata, {"skin.toml": self.skin.dump()})

    def _store(self, pattern: DrivePattern, stamp: int) -> bool:
        """See to it that the newest pattern in the file with this digest is this one."""
        assert self._pipe is not None
        if self._named.get(pattern.digest) is pattern:
            return True
        if self._named.get(pattern.digest) == pattern:
            self._named[pattern.digest] = pattern
            return True
        if not self._pipe.send(PATTERN, 0, stamp, encode_pattern(pattern)):
            return False
        self._named[pattern.digest] = pattern
        if len(self._named) > _MOST_PATTERNS:
            del self._named[next(iter(self._named))]
        return True
