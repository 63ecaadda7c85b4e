"""Recordings processed again: by the loop as it was, or by another mode or estimator."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ohmskin.device.replay import ReplayDevice, recorded_skin
from ohmskin.engine import Engine, State, Touch
from ohmskin.errors import DeviceError, PatternError
from ohmskin.sensing import SkinModel, Thresholds


@dataclass(frozen=True)
class Replayed:
    """One cycle of a recording, processed again.

    Args:
        time: Its time in the recording (s from the first frame after the calibration).
        touch: The result.
        known: The model of the quiet skin at that time; its `model.mesh` is that of the image.
        thresholds: gamma_0.
    """

    time: float
    touch: Touch
    known: SkinModel
    thresholds: Thresholds


class Player:
    """Runs an engine on a recording: calibrates, and changes the mode, where the recording did.

    Args:
        engine: Made on a `ReplayDevice`, not yet calibrated.
        mode: Use only this mode instead.
        notify: Called with a sentence when a mode is not possible.

    Raises:
        DeviceError: If the device of the engine is not a recording.
        PatternError: If cycles of `mode` were not recorded; the message lists those that were.
    """

    def __init__(self, engine: Engine, mode: str = "", notify: Callable[[str], None] = lambda _: None) -> None:
        device = engine.device
        if not isinstance(device, ReplayDevice):
            raise DeviceError(f"{device.url} is not a recording; open replay:FILE")
        self.device = device
        self._engine, self._notify = engine, notify
        device.calibrating = lambda: engine.state is State.CALIBRATING
        self._recorded, self._calibration, self._jumps = device.mode, device.calibration, device.jumps
        if mode:
            if not self._possible():
                raise PatternError(f"mode {mode!r} was not recorded; choose from {', '.join(self._modes()) or 'none'}")
        elif device.mode in engine.modes:
            engine.set_mode(device.mode)
        self._fixed, self._before = bool(mode), engine.state

    def prepare(self) -> None:
        """Call it before every `engine.step`."""
        engine, device = self._engine, self.device
        if device.loop and device.exhausted and not device.reference and engine.state is State.RUNNING:
            device.seek(0.0)  # now, so that the first cycle has the calibration and the mode of the beginning
        if device.jumps != self._jumps:
            self._jumps = device.jumps
            engine.forget()
        if engine.state is not State.RUNNING or device.reference or device.ended:
            return
        if device.calibration != self._calibration:
            self._calibration = device.calibration
            engine.calibrate()
        recorded, self._recorded = self._recorded, device.mode
        if self._recorded not in engine.modes:
            return
        if not self._possible():
            if self._engine.mode.name != recorded:
                self._notify(f"mode {self._engine.mode.name} was not recorded here; showing {self._recorded}")
            engine.set_mode(self._recorded)
        elif recorded != self._recorded and not self._fixed:
            engine.set_mode(self._recorded)

    def step(self) -> Touch | None:
        """One cycle; None at the end of the recording."""
        self.prepare()
        if self.device.ended:
            return None
        return self._unless_over(self._engine.step)

    def lead(self, step: Callable[[], Touch | None]) -> Callable[[], Touch | None]:
        """A loop's `step` on the recording. At the end it pauses; resuming there starts the recording again."""

        def led() -> Touch | None:
            before, self._before = self._before, self._engine.state
            if self.device.ended and self._engine.state is State.RUNNING:
                if before is State.PAUSED:
                    self.device.seek(0.0)
                else:
                    self._engine.pause(True)
                    self._before = State.PAUSED
                    self._notify("the recording has ended")
            self.prepare()
            return self._unless_over(step)

        return led

    def _unless_over(self, step: Callable[[], Touch | None]) -> Touch | None:
        try:
            return step()
        except DeviceError:  # the recording ended in the middle of a cycle
            if not self.device.ended:
                raise
            return None

    def _possible(self) -> bool:
        return bool(self.device.reference) or self.device.playable(self._engine.drive(self._engine.mode))

    def _modes(self) -> list[str]:
        return [mode.name for mode in self._engine.modes.values() if self.device.playable(self._engine.drive(mode))]


def reimage(
    path: str | Path,
    estimator: str = "",
    prior: str = "",
    rule: str = "",
    mode: str = "",
    skin: str = "",
    start: float = 0.0,
    stop: float = np.inf,
) -> Iterator[Replayed]:
    """Process a recording again, as fast as possible: the same settings give the same images to the last bit.

    Args:
        path: The recording, ours or others'.
        estimator, prior, rule: Names of another estimator, prior or rule than the recorded ones.
        mode: Another mode, whose scans must have been recorded; the recorded ones unless given.
        skin: Another description of the skin; the recorded one unless given.
        start, stop: From when to when (s from the first frame).

    Raises:
        DataError: If it is not a recording, or `start` is not in it.
        PatternError: If the mode was not recorded.
        ModelError: If there is no such estimator, prior or rule.
        DeviceError: If the skin is not that of the recording.
    """
    device = ReplayDevice(f"replay:{path}", speed=np.inf, start=start, loop=False)
    with (
        closing(device),
        Engine(
            lambda: device, recorded_skin(device, skin), mode, estimator=estimator, prior=prior, rule=rule
        ) as engine,
    ):
        player = Player(engine, mode)
        engine.calibrate()
        while not device.ended and (at := device.position) <= stop:
            if (touch := player.step()) is None:
                break
            assert engine.known is not None
            assert engine.sensor is not None
            yield Replayed(at, touch, engine.known, engine.sensor.thresholds)
