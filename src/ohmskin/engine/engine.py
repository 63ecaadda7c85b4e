"""The loop: device, perception, tracking and health, kept going whatever the device does."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ohmskin.device import Device
from ohmskin.drive import Mode, Policy
from ohmskin.engine.health import Health, HealthMonitor
from ohmskin.engine.perception import Perception, Sight
from ohmskin.errors import DeviceError, DeviceLost, PatternError
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Skin
from ohmskin.touch import Contact, Scene, Tracker, Tracks

_RETRY_AFTER = 0.5  # seconds between attempts to reach a lost device
_QUIET_SCANS = 40  # of each pattern, for the baseline
_LONGEST = 1.0  # seconds between two frames of a tracking mode beyond which nothing more is forgotten


class State(Enum):
    """What the loop is doing."""

    CALIBRATING = "calibrating"
    RUNNING = "running"
    PAUSED = "paused"
    LOST = "lost"


@dataclass(frozen=True)
class Touch:
    """What the skin feels now: the outcome of one cycle.

    Args:
        sequence: Number of the cycle.
        time: Time of the last sample on the host's monotonic clock (s).
        mode: The mode it was made in.
        sight: Frames, images and regions behind it.
        contacts: Tracked contacts, strongest first.
        health: How the loop is doing.
    """

    sequence: int
    time: float
    mode: Mode
    sight: Sight
    contacts: tuple[Contact, ...]
    health: Health


class Engine:
    """Runs the adaptive loop on any device. Calibrate it, then `step` it or iterate `touches`.

    Args:
        open_device: Opens the device; called again after it was lost.
        skin: What the device is.
        mode: Name of the drive mode; the best one unless given.
        report: Called with a sentence whenever something worth telling happens.

    Raises:
        DeviceError: If the device cannot be opened or does not fit the skin.
        PatternError: If the mode is not possible.
    """

    def __init__(
        self, open_device: Callable[[], Device], skin: Skin, mode: str = "", report: Callable[[str], None] = lambda _: None
    ) -> None:
        self.skin, self._open_device, self._report = skin, open_device, report
        self.state, self.message = State.CALIBRATING, ""
        self.device = self._opened()
        recorded = self.device.reference
        self.modes = (
            {"recorded": Mode("recorded", "the recording's own pattern", recorded[0].pattern)} if recorded else dict(skin.modes)
        )
        try:
            self.mode = self._named(mode or list(self.modes)[-1])
        except PatternError:
            self.device.close()
            raise
        self._sheet = skin.transfer_model()
        self.perception: Perception | None = None
        self._tracker, self._tracks = Tracker(), Tracks()
        self._scene: Scene | None = None
        self._before: float | None = None  # the device's time of the last frame
        self._monitor = HealthMonitor()
        self._sequence, self._sampled, self._retry_at, self._dropped_before = 0, 0.0, 0.0, 0
        self._missing = 0

    def calibrate(self, progress: Callable[[float], None] = lambda _: None) -> None:
        """Learn the quiet skin: reference data and noise, then gamma_0 of every mode. Nothing may touch it meanwhile.

        Args:
            progress: Called with the share done, 0 to 1.

        Raises:
            DeviceLost: If the device goes away. What was learned before is kept.
        """
        before, self.state = self.state, State.CALIBRATING
        try:
            quiet = list(self.device.reference) or self._quiet_frames(lambda share: progress(0.7 * share))
            perception = Perception(self.skin, self._sheet, quiet)
            cycles = 1 if self.device.reference else _QUIET_SCANS
            for done, mode in enumerate(self.modes.values()):
                progress(0.7 + 0.3 * done / len(self.modes))
                quiet_scan = self._scan if not self.device.reference else lambda _: quiet[0]
                perception.learn_thresholds(mode, quiet_scan, cycles)
        except DeviceLost as error:
            self._lose(error)
            raise
        except BaseException:  # what was learned before still holds
            self.state = before
            raise
        self.perception = perception
        self.forget()
        self.state = State.RUNNING
        progress(1.0)

    def step(self) -> Touch | None:
        """One cycle; None while there is nothing to see (paused, not calibrated, or the device is lost and sought again)."""
        if self.state is State.LOST:
            self._seek()
            return None
        if self.state is not State.RUNNING or self.perception is None:
            time.sleep(0.01)
            return None
        try:
            sight, contacts = self._tracked(policy) if (policy := self.mode.policy) else self._seen()
        except DeviceLost as error:
            self._lose(error)
            return None
        self._tell_missing(sight)
        self._sequence += 1
        dropped = self._dropped_before + self.device.dropped
        health = self._monitor.cycle(time.monotonic(), self._sampled, dropped, self.perception.baseline.noise)
        return Touch(self._sequence, self._sampled, self.mode, sight, contacts, health)

    def touches(self) -> Iterator[Touch]:
        """Cycles without end."""
        while True:
            if (touch := self.step()) is not None:
                yield touch

    def set_mode(self, name: str) -> None:
        """Switch to another drive mode from the next cycle on.

        Raises:
            PatternError: If it is not possible; the message lists the choices.
        """
        before, self.mode = self.mode, self._named(name)
        if self.mode.policy:
            self._tracks = Tracks(next_id=self._tracks.next_id)
        if self.mode is not before and self._scene is not None and self.perception is not None:
            self._scene = self.perception.filter.lifted(self._scene)

    @property
    def injections(self) -> int | None:
        """Injections per frame of a tracking mode; None in others."""
        policy = self.mode.policy
        return policy.injections if policy else None

    def set_injections(self, count: int) -> None:
        """Spend so many injections on every frame of the mode from the next cycle on; it must be a tracking mode.

        Raises:
            PatternError: If the mode does not track, or the device or the electrodes do not allow so many.
        """
        policy = self.mode.policy
        if policy is None:
            tracking = [name for name, mode in self.modes.items() if mode.policy]
            raise PatternError(f"mode {self.mode.name} has no choice of injections; choose one of {', '.join(tracking) or 'none'}")
        low, high = self.injection_limits(self.mode)
        if not low <= count <= high:
            raise PatternError(f"{count} injections per frame; mode {self.mode.name} takes {low} to {high} on this device")
        changed = copy(policy)
        changed.injections = count
        self.mode = self.modes[self.mode.name] = replace(self.mode, policy=changed)

    def injection_limits(self, mode: Mode) -> tuple[int, int]:
        """The least and the most injections per frame that can be set in a tracking mode."""
        policy, able = mode.policy, self.device.capabilities
        if policy is None:
            raise PatternError(f"mode {mode.name} has no choice of injections")
        per_injection = policy.complete.n_meas // policy.complete.n_inj
        most = min(policy.complete.n_inj, able.max_injections, able.max_measurements // per_injection)
        return 1, most

    def forget(self) -> None:
        """Let go of the contacts that are followed, because what comes next is another time."""
        self._tracks, self._scene, self._before = Tracks(), None, None

    def pause(self, paused: bool) -> None:
        """Stop scanning, or go on."""
        if self.state in (State.RUNNING, State.PAUSED):
            self.state = State.PAUSED if paused else State.RUNNING

    def press(self, number: int, at: tuple[float, float], radius: float, pressure: float) -> None:
        """Press a virtual skin; see `Device.press`. Does nothing while the device is lost.

        Raises:
            DeviceRefused: If the device is a real one, or the press is out of range.
        """
        if self.state is not State.LOST:
            try:
                self.device.press(number, at, radius, pressure)
            except DeviceLost as error:
                self._lose(error)

    def close(self) -> None:
        """Let go of the device. Safe twice."""
        self.device.close()

    def __enter__(self) -> "Engine":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _named(self, name: str) -> Mode:
        if name not in self.modes:
            raise PatternError(f"mode {name!r} is not possible with this skin; choose from {', '.join(self.modes)}")
        return self.modes[name]

    def _opened(self) -> Device:
        device = self._open_device()
        found, expected = device.capabilities.n_electrodes, len(self.skin.electrodes)
        if found != expected:
            device.close()
            raise DeviceError(
                f"the device has {found} electrodes, skin {self.skin.name!r} has {expected}; choose the skin that fits"
            )
        return device

    def _seen(self) -> tuple[Sight, tuple[Contact, ...]]:
        """A cycle of a mode that looks at every frame afresh."""
        assert self.perception is not None
        sight = self.perception.see(self.mode, self._scan)
        self._tracks, contacts = self._tracker.update(self._tracks, sight.contacts)
        return sight, contacts

    def _tracked(self, policy: Policy) -> tuple[Sight, tuple[Contact, ...]]:
        """A cycle of a tracking mode. Time is the device's or the recording's, so that a replay gives the same."""
        assert self.perception is not None
        scene = self._scene or self.perception.filter.start()
        self._scene, sight = self.perception.track(policy, self._scan, scene, self._elapsed)
        return sight, sight.contacts

    def _elapsed(self, frame: Frame) -> float:
        """Time since the last frame (s); as long as matters, where it is not known."""
        at = frame.time if frame.recorded is None else frame.recorded
        before, self._before = self._before, at
        if before is None or not 0 <= at - before <= _LONGEST:
            return _LONGEST
        return at - before

    def _quiet_frames(self, progress: Callable[[float], None]) -> list[Frame]:
        patterns = [mode.base for mode in self.modes.values()]
        patterns += [mode.complete for mode in self.modes.values()]
        able = self.device.capabilities
        pieces = [p for pattern in dict.fromkeys(patterns) for p in pattern.split(able.max_injections, able.max_measurements)]
        frames = []
        for done in range(_QUIET_SCANS):
            progress(done / _QUIET_SCANS)
            frames += [self._scan(piece) for piece in pieces]
        return frames

    def _scan(self, pattern: DrivePattern) -> Frame:
        asked = time.monotonic()
        frame = self.device.scan(pattern)
        arrived = time.monotonic()
        self._monitor.waited(arrived - asked)
        self._sampled = self._monitor.arrived(arrived, frame.time)
        return frame

    def _lose(self, error: DeviceLost) -> None:
        self.state, self._retry_at = State.LOST, time.monotonic() + _RETRY_AFTER
        self._dropped_before += self.device.dropped
        self.device.close()
        self._say(f"device lost: {error}; reconnecting")

    def _seek(self) -> None:
        if (wait := self._retry_at - time.monotonic()) > 0:
            time.sleep(min(wait, 0.02))
            return
        self._retry_at = time.monotonic() + _RETRY_AFTER
        known = self.device.capabilities.serial
        try:
            self.device = self._opened()
        except DeviceError as error:
            self.message = f"device lost: {error}; trying again"
            return
        self._monitor.reconnected()
        self.state = State.RUNNING if self.perception else State.CALIBRATING
        self._say("device is back")
        self.message = ""
        if self.device.capabilities.serial != known or self.perception is None:
            self._say("calibrating, because this is another device than before" if self.perception else "calibrating")
            with suppress(DeviceLost):  # gone again: sought again
                self.calibrate()

    def _tell_missing(self, sight: Sight) -> None:
        """Say when voltages begin to be left out of the image, and when none is any more."""
        missing = sum(int(np.count_nonzero(~np.isfinite(frame.voltages))) for frame in sight.frames)
        if missing and not self._missing:
            total = sum(frame.pattern.n_meas for frame in sight.frames)
            self._say(f"{missing} of {total} voltages are missing or clipped and left out of the image")
        elif self._missing and not missing:
            self._report("all voltages are there again")
            self.message = ""
        self._missing = missing

    def _say(self, message: str) -> None:
        self.message = message
        self._report(message)
