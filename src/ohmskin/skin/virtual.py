"""The virtual skin: what an instrument reads from a pressed sheet, ``converter(noise(sheet(presses)))``.

Not modelled: capacitance of the sheet beyond one settling time constant, that foam remembers a press that has gone,
temperature, drift, bending, cross-talk between cables, and that the patches also touch each other.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError
from ohmskin.scan import DrivePattern, Frame, FrameFlag
from ohmskin.skin.description import Skin
from ohmskin.skin.faults import PICKUP, Fault, Wiring
from ohmskin.skin.layer import Foam
from ohmskin.skin.twin import MOST_PRESSURE, Press, PressedSheet

_MOST_CONTACTS = 5000  # of patches under all presses: memory goes with the square, time with the cube
_YIELDED = 2e-3  # change of what acts on the sheet by which creeping foam is modelled anew
_ROUNDED = 1e-6  # m by which a place on the rim may seem to be off the sheet: it is sent in single precision


@lru_cache(maxsize=8)
def _sheet(skin: Skin, contact_factors: tuple[float, ...], contacts: int) -> PressedSheet:
    return PressedSheet(skin, contact_factors, contacts=contacts)


class VirtualSkin:
    """A skin that can be pressed and scanned, with the imperfections of its instrument.

    Args:
        skin: What it is.
        seed: Seed of the noise.
        faults: What is wrong with its wiring.
        contacts: Number of contacts between sheet and patch along each side of a patch, see `PressedSheet`.

    Raises:
        SkinError: If a fault names an electrode that is not there, or two faults name the same one.
    """

    def __init__(self, skin: Skin, seed: int | None = None, faults: Sequence[Fault] = (), contacts: int = 6) -> None:
        self.skin, self._contacts = skin, contacts
        self._wire(faults)
        self.reset(seed)

    def reset(self, seed: int | Sequence[int] | None = None, presses: Iterable[Press] = ()) -> None:
        """Return to the initial state: the clock at zero, noise from this seed, and only `presses`, numbered from 0.

        Raises:
            SkinError: If a press is off the sheet.
        """
        pressing = dict(enumerate(presses))
        for press in pressing.values():
            self._check_on_sheet(press)
        self._random = np.random.default_rng(seed)
        self._presses: dict[int, Press] = pressing
        self._time = 0.0
        self._foam, self._foam_time = self._foam_under(pressing, {}, 0.0), 0.0
        self._stale = False
        self._model()
        self._potentials = np.zeros(len(self.skin.electrodes))  # what the channels settled to last
        self._sequence = 0

    def rewire(self, *faults: Fault) -> None:
        """Replace all faults by these; clock and presses stay.

        Raises:
            SkinError: If a fault names an electrode that is not there, or two faults name the same one.
        """
        self._wire(faults)
        self._model()

    def _wire(self, faults: Sequence[Fault]) -> None:
        self.wiring = Wiring(faults, len(self.skin.electrodes))
        self.sheet = _sheet(self.skin, tuple(self.wiring.contact_factors.tolist()), self._contacts)

    @property
    def time(self) -> float:
        """The instrument's clock (s)."""
        return self._time

    @property
    def presses(self) -> dict[int, Press]:
        """The present presses, by number."""
        return dict(self._presses)

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        """Press the skin, move a press, or lift it.

        Args:
            number: Which press.
            x, y: Its centre, on the sheet (m).
            radius: Its radius (m), above 0.
            pressure: Its pressure (Pa); 0 lifts it.

        Raises:
            SkinError: If the place is off the sheet, radius or pressure are out of range, or all presses together take
                the model too long.
        """
        press, presses = Press((x, y), radius, pressure), self.presses
        if pressure == 0:  # what is left is modelled at the next scan, of many lifts once
            self._stale |= self._presses.pop(number, None) is not None
            self._foam = {other: foam for other, foam in self._foam.items() if other != number}
            return
        self._check_on_sheet(press)
        presses[number] = press
        if presses != self._presses:  # or told again, as hosts do when a reply is lost
            foam = self._foam_under(presses, self._foam, self._time - self._foam_time)
            resistance = self._pressed_resistance(presses, foam)  # may refuse: then nothing has changed
            self._presses, self._resistance, self._stale = presses, resistance, False
            self._foam, self._modelled, self._foam_time = foam, foam, self._time

    @property
    def transfer_resistance(self) -> Floats:
        """(n_elec, n_elec) transfer resistances between terminals without noise, as last modelled (ohm)."""
        return self._resistance

    def duration(self, pattern: DrivePattern) -> float:
        """How long the instrument takes for a scan of `pattern` (s)."""
        return self.skin.cost.time(pattern)

    def scan(self, pattern: DrivePattern) -> Frame:
        """Scan a pattern of the skin as it is now; returns at once, with the device time advanced by `duration`.

        Args:
            pattern: What is driven and measured.

        Raises:
            PatternError: If it names an electrode that is not there.
        """
        pattern.check(len(self.skin.electrodes))
        self._yield()
        if self._stale:
            self._model()
        currents, limited = self._drive(pattern)
        volts = self._settle(pattern, currents)
        noise, shunt = self.skin.converter.noise, self.skin.converter.shunt
        volts, clipped = self._convert(volts + self._random.normal(0, noise, volts.shape))
        over_shunt, too_much = self._convert(currents * shunt + self._random.normal(0, noise, currents.shape))
        self._time += self.duration(pattern)
        self._sequence += 1
        flags = FrameFlag(FrameFlag.CLIPPED * (clipped or too_much) | FrameFlag.CURRENT_LIMIT * limited)
        told = self._time, self._sequence, flags
        return Frame(pattern, volts, over_shunt / shunt, *told, auxiliary=self._auxiliary())

    def _auxiliary(self) -> float | None:
        """What the auxiliary channel reads."""
        channel, spread = self.skin.auxiliary, self.skin.contact_layer.foam_spread
        if not channel.kind:
            return None
        total = sum(press.force(spread) for press in self._presses.values())
        return channel.gain * total + float(self._random.normal(0, channel.noise))

    def _foam_under(self, presses: Mapping[int, Press], before: Mapping[int, Foam], elapsed: float) -> dict[int, Foam]:
        """The foam under each press, so long (s) after it was as before."""
        layer = self.skin.contact_layer
        pressed = presses.items() if layer.remembers else ()
        return {
            number: layer.acting(before.get(number), press.pressure, elapsed)
            for number, press in pressed
            if press.pressure > 0
        }

    def _yield(self) -> None:
        """Let the foam creep until now; what it does to the sheet is modelled anew once that has changed."""
        if not self.skin.contact_layer.creep or not self._presses:
            return
        self._foam = self._foam_under(self._presses, self._foam, self._time - self._foam_time)
        self._foam_time = self._time
        modelled = ((self._modelled[number].acting, foam.acting) for number, foam in self._foam.items())
        self._stale |= any(abs(now - before) > _YIELDED * before for before, now in modelled)

    def _model(self) -> None:
        """Model what presses now."""
        self._resistance = self._pressed_resistance(self._presses, self._foam)
        self._modelled, self._stale = self._foam, False

    def _pressed_resistance(self, presses: Mapping[int, Press], foam: Mapping[int, Foam]) -> Floats:
        if presses and (contacts := self.sheet.contacts_under(presses.values())) > _MOST_CONTACTS:
            slow = f"presses on {contacts} contacts of patches take about {1.4e-11 * contacts**3:.0f} s to model"
            raise SkinError(f"{slow}; allowed are {_MOST_CONTACTS}: make them smaller, or lift one")
        acting = (
            replace(press, pressure=min(foam[number].acting, MOST_PRESSURE)) if number in foam else press
            for number, press in presses.items()
        )
        return self.wiring.seen_from_terminals(self.sheet.transfer_resistance(acting))

    def _check_on_sheet(self, press: Press) -> None:
        if self.skin.domain.depth([press.position])[0] < -_ROUNDED:
            x, y = press.position
            bounds = self.skin.domain.bounds
            raise SkinError(f"press at ({x:.4g}, {y:.4g}) m is off the sheet; its bounds are {bounds} m")

    def _drive(self, pattern: DrivePattern) -> tuple[Floats, bool]:
        """The current (n_inj,) of each injection; a voltage source drives it through all in series."""
        (source, sink), r, supply = pattern.injections.T, self._resistance, self.skin.source
        pair = r[source, source] + r[sink, sink] - 2 * r[source, sink]
        wanted = self.skin.excitation.amplitude if supply is None else supply.amplitude / (pair + supply.resistance)
        currents = np.where(self._unconnected(pattern).any(axis=1), 0.0, wanted)
        limit = self.skin.excitation.current_limit
        return np.minimum(currents, limit), bool((currents > limit).any())

    def _settle(self, pattern: DrivePattern, currents: Floats) -> Floats:
        """Voltages (n_meas,) when they are sampled: each injection starts where the one before left the channels."""
        source, sink = pattern.injections.T
        settled = (self._resistance[source] - self._resistance[sink]) * currents[:, None]
        if self.wiring.open:
            settled = self._with_open_wires(pattern, settled)
        converter = self.skin.converter
        left = np.exp(-converter.settle / converter.time_constant) if converter.time_constant > 0 else 0.0
        potentials = np.empty_like(settled)
        for k, target in enumerate(settled):
            self._potentials = potentials[k] = target + left * (self._potentials - target)
        which, plus, minus = pattern.measurements.T
        voltages: Floats = potentials[which, plus] - potentials[which, minus]
        return voltages

    def _unconnected(self, pattern: DrivePattern) -> NDArray[np.bool_]:
        """Which sources and sinks (n_inj, 2) have no wire."""
        return np.isin(pattern.injections, self.wiring.open)

    def _with_open_wires(self, pattern: DrivePattern, settled: Floats) -> Floats:
        """The potentials (n_inj, n_elec) of all terminals against the sink, which is the instrument's ground."""
        rows = np.arange(pattern.n_inj)
        source, sink = pattern.injections.T
        open_source, open_sink = self._unconnected(pattern).T
        settled = settled - settled[rows, sink][:, None]
        # without a way back the whole sheet takes the source's potential; a current source goes to the end of its range
        source_volts, excitation = 2 * self.skin.converter.full_scale, self.skin.excitation
        drive = excitation.amplitude if excitation.source == "voltage" else source_volts
        settled[open_sink & ~open_source] = drive
        settled[:, list(self.wiring.open)] = self._random.normal(0, PICKUP, (pattern.n_inj, len(self.wiring.open)))
        settled[rows, sink] = 0.0
        settled[rows[open_source | open_sink], source[open_source | open_sink]] = drive
        return settled

    def _convert(self, volts: Floats) -> tuple[Floats, bool]:
        """The converter's steps and range; beyond the range, infinite."""
        converter = self.skin.converter
        step = 2 * converter.full_scale / 2**converter.bits
        over = np.abs(volts) > converter.full_scale
        return np.where(over, np.copysign(np.inf, volts), np.round(volts / step) * step), bool(over.any())
