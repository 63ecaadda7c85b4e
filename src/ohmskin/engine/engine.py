"""The loop: device, sensor and health, kept going whatever the device does."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from threadpoolctl import threadpool_limits

from ohmskin.calibrate.measures import check_fit
from ohmskin.closing import Closing
from ohmskin.compiler import compiling
from ohmskin.device import Capabilities, Device
from ohmskin.drive import Drive, Fixed
from ohmskin.engine.compiling import Compilation
from ohmskin.engine.health import HealthMonitor
from ohmskin.engine.notices import Notices, lost
from ohmskin.engine.quiet import MEASURED, QuietFrames, check_usable
from ohmskin.engine.sensors import Sensors
from ohmskin.engine.touch import State, Touch
from ohmskin.errors import LINK_ERRORS, DataError, DeviceError, DeviceLost, ModelError, OhmskinError, PatternError
from ohmskin.gestures import GestureFollower
from ohmskin.scan import DrivePattern, Frame, assess, needed
from ohmskin.sensing import Belief, Sensor, SensorState, SkinModel, default_mode, drive_of, modes, recorded_mode
from ohmskin.sensing.lifted import corrected
from ohmskin.skin import Mode, Skin

_RETRY_AFTER = 0.5  # seconds between attempts to reach a lost device
_LIKELY = 0.5  # confidence of a contact from which on it may have been on the skin while that was to be quiet
_ROOM = ("max_injections", "max_measurements")  # what sensors rely on


class Engine(Closing):
    """Runs the adaptive loop on any device. Calibrate it, then `step` it or iterate `touches`.

    While it is open, BLAS uses one thread: small products are then faster, and reproducible to the last bit.

    Args:
        open_device: Opens the device; called again after it was lost.
        skin: What the device is.
        mode: Name of the mode; the one with the smallest measured error unless given.
        report: Called with every message for the user.
        compilation: A running compilation: until it ends, a mode that needs it is replaced by one that does not.
        estimator, prior, rule: Names from `ESTIMATORS`, `PRIORS` and `RULES` to use instead of those of the modes.

    Attributes:
        modes: The modes of the skin, by name.
        known, sensor: The model of the quiet skin, and the present sensor; None before the first calibration.
        scans_made: Scans of the present cycle so far.

    Raises:
        DeviceError: If the device cannot be opened or does not fit the skin.
        PatternError: If the mode is not possible.
    """

    def __init__(
        self,
        open_device: Callable[[], Device],
        skin: Skin,
        mode: str = "",
        report: Callable[[str], None] = lambda _: None,
        compilation: Compilation | None = None,
        *,
        estimator: str = "",
        prior: str = "",
        rule: str = "",
    ) -> None:
        self.skin, self._open_device, self._notices, self.state = skin, open_device, Notices(report), State.CALIBRATING
        self._progress: Callable[[float], None] = lambda _: None
        self.device = self._opened()
        recorded = self.device.reference
        self._recorded: Drive | None = Fixed(recorded[0].pattern) if recorded else None
        found = {"recorded": recorded_mode(skin)} if recorded else modes(skin)
        self.modes = {name: one.using(estimator, prior, rule) for name, one in found.items()}
        self._sensors = Sensors(self._drive_of, compilation)
        try:
            begins = self.device.default_mode if self.device.default_mode in self.modes else default_mode(skin)
            self.mode = self._chosen(mode or begins)
        except PatternError:
            self.device.close()
            raise
        self._threads = threadpool_limits(1, "blas")
        self._sheet = skin.transfer_model()
        self.known: SkinModel | None = None
        self.sensor: Sensor | None = None
        self._sensed: SensorState
        self._beliefs: dict[str, Belief] = {}  # the last one of each reader
        self._monitor, self._gestures = HealthMonitor(), GestureFollower()
        self._sequence, self._sampled, self._retry_at, self._dropped_before, self.scans_made = 0, 0.0, 0.0, 0, 0

    @property
    def message(self) -> str:
        """Notice for the user, such as why the device is lost; empty if there is none."""
        return self._notices.message

    def calibrate(self, progress: Callable[[float], None] | None = None) -> None:
        """Learn the quiet skin: reference data and noise, then gamma_0 of the mode. Keep it untouched meanwhile.

        Args:
            progress: Called with the share done, 0 to 1, also when the loop calibrates by itself; None: as before.

        Raises:
            DeviceLost: If the device is lost. The previous calibration is kept.
            DataError: If the skin is not quiet, or its data are no skin's; likewise.
            ModelError: If the estimator or the prior is unknown, or does not go with the skin.
            PatternError: If the device cannot drive the mode.
        """
        progress = self._progress = progress or self._progress
        (before, message), self.state = (self.state, self.message), State.CALIBRATING
        detected = self.known and any(one.confidence > _LIKELY for one in self._sensed.belief.contacts)

        def compiles(sentence: str) -> None:
            self._notices.message = sentence
            progress(MEASURED)

        try:
            quiet, notes, quality = list(self.device.reference), list[str](), None
            if not quiet:
                quiet, notes = self._quiet_frames(lambda share: progress(MEASURED * share))
                quality = assess(quiet)
                check_usable(quality)
            with compiling(compiles, threaded=False):
                known = SkinModel(self.skin, self._sheet, quiet, quality if quality and quality.verdicts else None)
                self._sensors.renew(self.mode, known)
        except DeviceLost as error:
            self._lose(error)
            raise
        except BaseException:  # what was learned before still holds
            self.state, self._notices.message = before, message
            raise
        self.known = known
        self._notices.calibrated(notes, known, bool(detected), quality is not None)
        self.forget()
        self.state = State.RUNNING
        progress(1.0)

    def step(self) -> Touch | None:
        """One cycle; None while paused, not calibrated, or reconnecting to a lost device."""
        if self.state is State.LOST:
            self._seek()
            return None
        if self.state is not State.RUNNING or self.sensor is None or self.known is None:
            time.sleep(0.01)
            return None
        self.scans_made = 0
        try:
            if due := self._sensors.due():
                self.set_mode(due)
                self._notices.awaited("", f"{self.mode.label} from here on")
            before = replace(self._sensed, uses_total=self._notices.total_trusted)
            self._sensed, percept = self.sensor.step(before, self._scan)
        except LINK_ERRORS as error:  # a new connection may help
            self._lose(error)
            return None
        except (DataError, ModelError) as error:  # of these data; the next ones may be better
            self._notices.unread(str(error))
            return None
        self._notices.unread("")
        self._notices.findings(percept.findings)
        self._notices.auxiliary(self.known, percept)
        if percept.lifted is not None:
            self.known = corrected(self.known, self._sheet, percept.lifted)
            self._sensors.renew(self.mode, self.known)
            self._notices.lifted(percept.lifted)
            self.forget()
        self._sequence += 1
        dropped = self._dropped_before + self.device.dropped
        health = self._monitor.cycle(time.monotonic(), self._sampled, dropped, self.known.baseline.noise)
        self._notices.pace(self.mode, self.sensor.seconds, health.rate)
        gestures = self._gestures.after(self._sampled, percept.contacts)
        return Touch(self._sequence, self._sampled, self.mode, percept, percept.contacts, health, gestures)

    def touches(self) -> Iterator[Touch]:
        """All cycles, endlessly."""
        while True:
            if (touch := self.step()) is not None:
                yield touch

    def set_mode(self, name: str) -> None:
        """Switch to the mode of that `name` from the next cycle on.

        Raises:
            PatternError: If it is not one of `modes`; the message lists them.
            ModelError: If its estimator, prior or rule is unknown, or does not go with the skin.
        """
        self._switch(self._chosen(name))

    def ready(self, mode: Mode) -> bool:
        """Whether the sensor of a mode is already built; building one takes a while."""
        return self.known is None or mode in self._sensors

    def set_estimator(self, estimator: str = "", prior: str = "", rule: str = "") -> None:
        """Use another estimator, prior or rule in all modes from the next cycle on; empty ones stay unchanged.

        Raises:
            ModelError: If one is unknown, or does not go with the skin; nothing is changed then.
        """
        changed = {name: mode.using(estimator, prior, rule) for name, mode in self.modes.items()}
        if self.known is not None:
            self._sensors.sensor(changed[self.mode.name], self.known)
        self.modes = changed
        self._switch(changed[self.mode.name])

    @property
    def injections(self) -> int | None:
        """Injections per frame of a mode whose drive takes any number; None in others."""
        return self.drive(self.mode).injections if self.drive(self.mode).adjustable else None

    def set_injections(self, count: int) -> None:
        """Make `count` injections per frame of the mode from the next cycle on; its drive must allow any number.

        Raises:
            PatternError: If it does not, or `count` is not within the `injection_limits`.
        """
        mode, (low, high) = self.mode, self.injection_limits(self.mode)
        if not low <= count <= high:
            raise PatternError(f"{count} injections per frame; mode {mode.name} takes {low} to {high} on this device")
        changed = replace(mode, injections=count)
        self._sensors.adjust(mode, changed)
        self.mode = self.modes[changed.name] = changed
        if self.known is not None:
            self.sensor = self._sensors.sensor(changed, self.known)

    def injection_limits(self, mode: Mode) -> tuple[int, int]:
        """Smallest and largest number of injections per frame of a mode whose drive allows any number.

        Raises:
            PatternError: If it does not.
        """
        return self._sensors.injection_limits(mode, self.modes, self.device.capabilities)

    def drive(self, mode: Mode) -> Drive:
        """The drive of a mode."""
        return self._sensors.drive(mode)

    def forget(self) -> None:
        """Delete all tracks, because the next frame is of another time."""
        self._beliefs.clear()
        if self.known is not None:
            self.sensor = self._sensors.sensor(self.mode, self.known)
            self._sensed = self.sensor.start()

    def pause(self, paused: bool) -> None:
        """Pause scanning, or resume it where `paused` is false; without effect while calibrating or lost."""
        if self.state in (State.RUNNING, State.PAUSED):
            self.state = State.PAUSED if paused else State.RUNNING

    def press(self, number: int, at: tuple[float, float], radius: float, pressure: float) -> None:
        """Press a virtual skin; arguments as for `Device.press`. Does nothing while the device is lost.

        Raises:
            DeviceRefused: If the device is a real one, or the press is out of range.
        """
        if self.state is not State.LOST:
            try:
                self.device.press(number, at, radius, pressure)
            except DeviceLost as error:
                self._lose(error)

    def close(self) -> None:
        """Close the device. Safe to call twice."""
        self.device.close()
        self._threads.restore_original_limits()

    def _chosen(self, name: str) -> Mode:
        """The mode of that name, or the one that stands in for it, which is said."""
        if name not in self.modes:
            raise PatternError(f"mode {name!r} is not possible with this skin; choose from {', '.join(self.modes)}")
        wanted = self.modes[name]
        chosen = self._sensors.stand_in(wanted, self.modes)
        if self._sensors.awaited:
            self._notices.awaited(f"compiling, once on this machine; {chosen.label} until {wanted.label} is ready")
        return chosen

    def _drive_of(self, mode: Mode) -> Drive:
        return self._recorded or drive_of(mode, self.skin, self.device.capabilities.driven)

    def _opened(self, before: Capabilities | None = None) -> Device:
        able = (device := self._open_device()).capabilities
        try:
            check_fit(device, self.skin, before)
            if before and any(getattr(able, name) < getattr(before, name) for name in _ROOM):
                raise DeviceError("this device takes smaller patterns than the previous one; restart ohmskin with it")
        except DeviceError:
            device.close()
            raise
        return device

    def _switch(self, mode: Mode) -> None:
        """Sense in another mode, with the names and the drift that its reader knew last."""
        if mode != self.mode and self.sensor is not None and self.known is not None:
            self._beliefs[self.mode.reader] = self._sensed.belief
            self.sensor = self._sensors.sensor(mode, self.known)
            self._sensed = self.sensor.start(self._beliefs.get(mode.reader))
        self.mode = mode

    def _quiet_frames(self, progress: Callable[[float], None]) -> tuple[list[Frame], list[str]]:
        patterns: dict[DrivePattern, None] = {}
        for mode in list(self.modes.values()):
            try:
                patterns |= dict.fromkeys(self.drive(mode).patterns)
            except PatternError as error:  # go without it, unless it is the one wanted
                if mode.name in (self.mode.name, self._sensors.awaited):
                    raise
                del self.modes[mode.name]
                self._notices.say(f"mode {mode.name} is not possible: {error}")
        quiet = QuietFrames(needed(patterns), self.device.capabilities, self._scan, progress)
        return quiet.measured(), quiet.notes

    def _scan(self, pattern: DrivePattern) -> Frame:
        asked = time.monotonic()
        frame = self.device.capabilities.limited(self.device.scan(pattern))
        arrived = time.monotonic()
        self._monitor.waited(arrived - asked)
        self._sampled = self._monitor.arrived(arrived, frame.time)
        self.scans_made += 1
        return frame

    def _lose(self, error: OhmskinError) -> None:
        self.state, self._retry_at = State.LOST, time.monotonic() + _RETRY_AFTER
        self._dropped_before += self.device.dropped
        self.device.close()
        self._notices.say(lost(error))

    def _seek(self) -> None:
        if (wait := self._retry_at - time.monotonic()) > 0:
            time.sleep(min(wait, 0.02))
            return
        before, self._retry_at = self.device.capabilities, time.monotonic() + _RETRY_AFTER
        try:
            self.device = self._opened(before)
        except DeviceLost as error:  # still away
            self._notices.message = lost(error)
            return
        except DeviceError as error:
            self._notices.say(lost(error))
            return
        self._monitor.reconnected()
        self.state = State.RUNNING if self.known else State.CALIBRATING
        self._notices.say("device is back")
        self._notices.message = ""
        if self.device.capabilities.serial != before.serial or self.known is None:
            why = ", because this is another device than the previous one" if self.known else ""
            self._notices.say(f"calibrating{why}")
            try:
                self.calibrate()
            except DeviceLost:  # gone again: sought again
                pass
            except OhmskinError as error:  # what is known is of another device
                self.known = self.sensor = None
                self._lose(error)
