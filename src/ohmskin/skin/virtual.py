"""The virtual skin: what an instrument reads from a pressed sheet, ``converter(noise(sheet(presses)))``.

Not modelled: capacitance of the sheet beyond one settling time constant, creep and hysteresis of the foam, temperature,
drift, bending, cross-talk between cables, and that the patches also touch each other.
"""

import numpy as np

from ohmskin.errors import SkinError
from ohmskin.geometry.domain import Floats
from ohmskin.scan import DrivePattern, Frame, FrameFlag
from ohmskin.skin.description import Skin
from ohmskin.skin.twin import Press, PressedSheet


class VirtualSkin:
    """A skin that can be pressed and scanned, with the imperfections of its instrument.

    Args:
        skin: What it is.
        seed: Seed of the noise.
    """

    def __init__(self, skin: Skin, seed: int | None = None) -> None:
        self.skin = skin
        self.sheet = PressedSheet(skin)
        self._random = np.random.default_rng(seed)
        self._presses: dict[int, Press] = {}
        self._resistance = self.sheet.untouched
        self._potentials = np.zeros(len(skin.electrodes))  # what the channels settled to last
        self._time = 0.0
        self._sequence = 0

    @property
    def presses(self) -> dict[int, Press]:
        """What presses now, by number."""
        return dict(self._presses)

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        """Press at (x, y), or move press `number` there (metres, pascals). No pressure lifts it.

        Raises:
            SkinError: If the place is off the sheet, or radius or pressure are out of range.
        """
        press = Press((x, y), radius, pressure)
        if pressure > 0 and self.skin.domain.depth([press.position])[0] < 0:
            raise SkinError(f"press at ({x:.4g}, {y:.4g}) m is off the sheet; its bounds are {self.skin.domain.bounds} m")
        if pressure > 0:
            self._presses[number] = press
        else:
            self._presses.pop(number, None)
        self._resistance = self.sheet.transfer_resistance(self._presses.values())

    def duration(self, pattern: DrivePattern) -> float:
        """How long the instrument takes for a scan (s)."""
        return pattern.n_inj * (self.skin.converter.settle + self.skin.converter.conversion)

    def scan(self, pattern: DrivePattern) -> Frame:
        """Scan the skin as it is now; returns at once, with the device time advanced by `duration`."""
        pattern.check(len(self.skin.electrodes))
        currents, limited = self._drive(pattern)
        volts = self._settle(pattern, currents)
        volts, clipped = self._convert(volts + self._random.normal(0, self.skin.converter.noise, volts.shape))
        shunt = self.skin.converter.shunt
        over_shunt, too_much = self._convert(currents * shunt + self._random.normal(0, self.skin.converter.noise, currents.shape))
        self._time += self.duration(pattern)
        self._sequence += 1
        flags = FrameFlag.CLIPPED if clipped or too_much else FrameFlag(0)
        flags |= FrameFlag.CURRENT_LIMIT if limited else FrameFlag(0)
        return Frame(pattern, volts, over_shunt / shunt, self._time, self._sequence, flags)

    def _drive(self, pattern: DrivePattern) -> tuple[Floats, bool]:
        """The current (n_inj,) of each injection; a voltage source drives it through the pair and all that is in series."""
        source, sink = pattern.injections.T
        excitation, r = self.skin.excitation, self._resistance
        if excitation.source == "current":
            currents = np.full(pattern.n_inj, excitation.amplitude)
            return np.minimum(currents, excitation.current_limit), excitation.amplitude > excitation.current_limit
        pair = r[source, source] + r[sink, sink] - 2 * r[source, sink]
        series = excitation.resistance + 2 * excitation.multiplexer_resistance + self.skin.converter.shunt
        currents = excitation.amplitude / (pair + series)
        return np.minimum(currents, excitation.current_limit), bool((currents > excitation.current_limit).any())

    def _settle(self, pattern: DrivePattern, currents: Floats) -> Floats:
        """Voltages (n_meas,) when they are sampled: each injection starts from where the one before it left the channels."""
        source, sink = pattern.injections.T
        settled = (self._resistance[source] - self._resistance[sink]) * currents[:, None]
        converter = self.skin.converter
        left = np.exp(-converter.settle / converter.time_constant) if converter.time_constant > 0 else 0.0
        potentials = np.empty_like(settled)
        for k, target in enumerate(settled):
            self._potentials = potentials[k] = target + left * (self._potentials - target)
        which, plus, minus = pattern.measurements.T
        voltages: Floats = potentials[which, plus] - potentials[which, minus]
        return voltages

    def _convert(self, volts: Floats) -> tuple[Floats, bool]:
        """The converter's steps and range; beyond the range, infinite."""
        converter = self.skin.converter
        step = 2 * converter.full_scale / 2**converter.bits
        over = np.abs(volts) > converter.full_scale
        return np.where(over, np.copysign(np.inf, volts), np.round(volts / step) * step), bool(over.any())
