"""The sensors of an engine's modes, each made when it is first asked for, and the mode that stands in for another."""

import time
from collections.abc import Callable, Mapping

from ohmskin.device import Capabilities
from ohmskin.drive import Drive
from ohmskin.engine.compiling import Compilation
from ohmskin.errors import PatternError
from ohmskin.sensing import Sensor, SkinModel, build
from ohmskin.skin import Mode

_GIVE_WAY = 0.02  # s a frame, which leaves some 20 of them a second


class Sensors:
    """Drives and sensors by mode.

    Args:
        drive_of: Makes the drive of a mode.
        compilation: What sensors that fit contacts wait for.

    Attributes:
        awaited: Name of the mode that follows once it is compiled; empty if none does.
    """

    def __init__(self, drive_of: Callable[[Mode], Drive], compilation: Compilation | None) -> None:
        self._drive_of, self._compilation, self.awaited = drive_of, compilation, ""
        self._drives: dict[Mode, Drive] = {}
        self._sensors: dict[Mode, Sensor] = {}

    def __contains__(self, mode: Mode) -> bool:
        """Whether the sensor of a mode is built already."""
        return mode in self._sensors

    def drive(self, mode: Mode) -> Drive:
        """The drive of a mode."""
        if mode not in self._drives:
            self._drives[mode] = self._drive_of(mode)
        return self._drives[mode]

    def sensor(self, mode: Mode, known: SkinModel) -> Sensor:
        """The sensor of a mode, as it was built first."""
        if mode not in self._sensors:
            self._sensors[mode] = build(mode, known, self.drive(mode), fast=not self._compiling)
        return self._sensors[mode]

    def renew(self, mode: Mode, known: SkinModel) -> None:
        """Build the sensor of a mode for a skin newly learned; others when they are asked for. What was there is kept
        if that fails."""
        before, self._sensors = self._sensors, {}
        try:
            self.sensor(mode, known)
        except BaseException:
            self._sensors = before
            raise

    def adjust(self, mode: Mode, changed: Mode) -> None:
        """Let a mode have another number of injections: a sensor that is there takes the new drive."""
        self._drives[changed] = self.drive(mode).with_injections(changed.injections)
        if mode in self._sensors:
            self._sensors[changed] = self._sensors[mode].with_drive(self._drives[changed])

    def injection_limits(self, mode: Mode, modes: Mapping[str, Mode], able: Capabilities) -> tuple[int, int]:
        """Smallest and largest number of injections per frame of one of the `modes`, on a device that is `able` to.

        Raises:
            PatternError: If the mode's drive does not allow any number.
        """
        drive = self.drive(mode)
        if not drive.adjustable:
            others = ", ".join(name for name, one in modes.items() if self.drive(one).adjustable) or "none"
            raise PatternError(f"mode {mode.name} has no choice of injections; choose one of {others}")
        complete = drive.patterns[0]
        per_injection = complete.n_meas // complete.n_inj
        return 1, min(complete.n_inj, able.max_injections, able.max_measurements // per_injection)

    def stand_in(self, mode: Mode, modes: Mapping[str, Mode]) -> Mode:
        """The mode to sense in: the one wanted, or while that is compiled one without fits, adaptive if there is one.

        The one wanted is `awaited` then.
        """
        self.awaited = ""
        if mode.reader == "centroid" or not self._compiling:
            return mode
        plain = [one for one in modes.values() if one.reader == "centroid"]
        if not plain:
            return mode
        self.awaited = mode.name
        return next((one for one in plain if one.drive == "eq7"), plain[0])

    def due(self) -> str:
        """Name of the mode that was awaited and can begin now; empty if none can, and what compiles gets time."""
        if self._compilation is None:
            return ""
        if self._compiling:
            time.sleep(_GIVE_WAY)
            return ""
        self._compilation.close()
        self._compilation = None
        self._sensors.clear()  # those built meanwhile are the slow ones
        name, self.awaited = self.awaited, ""
        return name

    @property
    def _compiling(self) -> bool:
        return self._compilation is not None and self._compilation.under_way
