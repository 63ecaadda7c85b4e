"""A multiplexer board and a separate data acquisition card as one device: the paper's arrangement (section IV-B).

The board connects a source and a sink electrode to the excitation; the card digitises all electrodes at once, and the
voltage over a shunt in the sink's path. Fill two small protocols for your own parts; `MuxDaqDevice` does the rest.
"""

import time
from contextlib import suppress
from typing import Protocol

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.driver import Device
from ohmskin.errors import DeviceError, DeviceLost
from ohmskin.scan import DrivePattern, Frame, FrameFlag


class Multiplexer(Protocol):
    """A board that connects two electrodes to the excitation. Failures are OSError or DeviceError."""

    def connect(self, source: int, sink: int) -> None:
        """Connect a source and a sink electrode; returns only when the switches have been set."""

    def release(self) -> None:
        """Connect nothing, so that no current flows."""

    def close(self) -> None:
        """Close the board."""


class Acquisition(Protocol):
    """A card that samples all electrodes at once. Failures are OSError or DeviceError."""

    def sample(self) -> tuple[Floats, float]:
        """Potential (n_elec,) of each electrode against the common ground, and the voltage over the shunt (V), now."""

    def close(self) -> None:
        """Close the card."""


class MuxDaqDevice(Device):
    """A multiplexer board and a data acquisition card as a device.

    Args:
        url: What to call it.
        mux: The board.
        daq: The card.
        n_elec: Number of electrodes.
        shunt: Resistance that the current flows through on its way to the ground (ohm).
        excitation: Voltage of the source (V).
        full_scale: Largest voltage that the card converts (V).
        settle: Waiting time after each switching (s); `ohmskin self-test` says whether it is enough.
        averages: Samples that a value is the mean of.
        conversion: How long one sample of all electrodes takes (s).
        name: Name of the device.

    Raises:
        DeviceError: If a number is out of range (ProtocolError if it is one of the capabilities).
    """

    def __init__(
        self,
        url: str,
        mux: Multiplexer,
        daq: Acquisition,
        *,
        n_elec: int,
        shunt: float,
        excitation: float,
        full_scale: float,
        settle: float = 200e-6,
        averages: int = 1,
        conversion: float = 20e-6,
        name: str = "mux and daq",
    ) -> None:
        if not shunt > 0:
            raise DeviceError(f"shunt is {shunt} ohm; it must be positive")
        if not settle >= 0:
            raise DeviceError(f"settle is {settle} s; it must not be negative")
        if averages < 1:
            raise DeviceError(f"averages is {averages}; it must be 1 or more")
        able = Capabilities(
            name,
            n_elec,
            max_injections=1024,
            max_measurements=4096,
            features=Feature.VOLTAGE_SOURCE | Feature.CURRENT_MEASURED | Feature.DRIVEN_MEASURED,
            excitation=excitation,
            full_scale=full_scale,
            # all electrodes at once: it does not grow with the voltages asked for
            settle_time=settle + averages * conversion,
        )
        super().__init__(url, able)
        self._mux, self._daq, self._shunt, self._settle, self._averages = mux, daq, shunt, settle, averages
        self._sequence = 0

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        deadline = time.monotonic() + timeout
        potentials, over_shunt = np.empty((pattern.n_inj, self.capabilities.n_electrodes)), np.empty(pattern.n_inj)
        try:
            for k, (source, sink) in enumerate(pattern.injections.tolist()):
                self._mux.connect(source, sink)
                time.sleep(self._settle)
                potentials[k], over_shunt[k] = self._sampled()
                if time.monotonic() > deadline:
                    done = f"{k + 1} of {pattern.n_inj} injections in {timeout:g} s"
                    raise DeviceLost(f"{self.url} measured {done}; check the card's trigger")
            sampled = time.monotonic()
        except DeviceLost:
            raise
        except OSError as error:
            raise DeviceLost(f"{self.url} failed during a scan: {error}; check its cables and connect again") from error
        finally:
            self._release()  # current flows only while it is measured, whatever goes wrong
        which, plus, minus = pattern.measurements.T
        limit = self.capabilities.full_scale
        over = np.abs(potentials) >= limit
        volts = potentials[which, plus] - potentials[which, minus]
        clipped = over[which, plus] | over[which, minus]
        flags = FrameFlag.CLIPPED if clipped.any() else FrameFlag(0)
        self._sequence += 1
        volts = np.where(clipped, np.copysign(np.inf, volts), volts)
        return Frame(pattern, volts, over_shunt / self._shunt, sampled, self._sequence, flags)

    def _sampled(self) -> tuple[Floats, float]:
        """The mean of some samples; a value that leaves the range once stays out of it."""
        samples = [self._daq.sample() for _ in range(self._averages)]
        potentials = np.stack([np.asarray(values, float) for values, _ in samples])
        if potentials.shape[1:] != (self.capabilities.n_electrodes,):
            raise DeviceError(f"{self.url}: the card gave {potentials.shape[1:]} values; need one for each electrode")
        limit = self.capabilities.full_scale
        worst = potentials[np.argmax(np.abs(potentials), axis=0), np.arange(potentials.shape[1])]
        mean = np.where(np.abs(worst) >= limit, worst, potentials.mean(axis=0))
        return mean, float(np.mean([shunt for _, shunt in samples]))

    def _release(self) -> None:
        with suppress(OSError, DeviceError):  # it is gone; the next scan says so, if the last one has not
            self._mux.release()

    def _close(self) -> None:
        self._release()
        for part in (self._mux, self._daq):
            with suppress(OSError, DeviceError):
                part.close()
