"""
A driver of your own
====================

For a multiplexer board and a separate National Instruments card, the paper's arrangement, as a plug-in.
``python examples/mux_and_daq.py`` checks the driver on a simulated board and card.

Copy it, change the two classes at the top to your own parts, and name ``open_rig`` as an entry point in your package's
pyproject.toml; every command then takes ``--device rig:/dev/ttyUSB0,Dev1``::

    [project.entry-points."ohmskin.devices"]
    rig = "my_package.mux_and_daq:open_rig"

Tested on the simulated parts below. ``SerialMux`` and ``NiCard`` show where real ones go; they were not run on hardware
here.
"""

# sphinx_gallery_thumbnail_path = 'images/build/wiring.png'
import sys

import numpy as np
import serial

import ohmskin as ohm
from ohmskin.device.conformance import check_device
from ohmskin.device.daq import MuxDaqDevice
from ohmskin.errors import DeviceError, DeviceLost

SHUNT, FULL_SCALE, SUPPLY = 100.0, 5.0, 5.0  # ohm, V, V
ELECTRODES = 16


class SerialMux:
    """A microcontroller that sets the address lines of two MAX306: `S 3 7` connects, `S - -` releases, it answers
    `ok`."""

    def __init__(self, port: str) -> None:
        try:
            self._port = serial.Serial(port, 115200, timeout=0.2, exclusive=True)
        except OSError as error:
            raise DeviceLost(f"cannot open the multiplexer board at {port}: {error}; is it plugged in?") from error

    def connect(self, source: int, sink: int) -> None:
        self._ask(f"S {source} {sink}")

    def release(self) -> None:
        self._ask("S - -")

    def close(self) -> None:
        self._port.close()

    def _ask(self, line: str) -> None:
        self._port.write(f"{line}\n".encode())
        if (answer := self._port.readline().strip()) != b"ok":
            raise DeviceLost(f"the multiplexer board answered {answer!r} to {line!r}; check its cable and firmware")


class NiCard:
    """A card that samples simultaneously: electrodes on ai0 to ai15, the shunt on ai16.

    Needs nidaqmx and NI's driver.
    """

    def __init__(self, card: str) -> None:
        try:
            import nidaqmx  # type: ignore[import-not-found]
        except ImportError as error:
            raise DeviceError("this card needs: pip install nidaqmx, and NI's driver from ni.com") from error
        self._task = nidaqmx.Task()
        self._task.ai_channels.add_ai_voltage_chan(f"{card}/ai0:{ELECTRODES}", min_val=-FULL_SCALE, max_val=FULL_SCALE)

    def sample(self) -> tuple[np.ndarray, float]:
        values = np.array(self._task.read())
        return values[:ELECTRODES], float(values[ELECTRODES])

    def close(self) -> None:
        self._task.close()


def open_rig(url: str) -> MuxDaqDevice:
    """Open `rig:/dev/ttyUSB0,Dev1`: port of the board, name of the card."""
    port, comma, card = url.partition(":")[2].partition(",")
    if not comma:
        raise DeviceError(f"{url!r} lacks a card; need rig:PORT,CARD such as rig:/dev/ttyUSB0,Dev1")
    return _device(url, SerialMux(port), NiCard(card))


def _device(url: str, mux: object, daq: object) -> MuxDaqDevice:
    return MuxDaqDevice(url, mux, daq, n_elec=ELECTRODES, shunt=SHUNT, excitation=SUPPLY, full_scale=FULL_SCALE)


class Simulated:
    """Board and card in one, on the physics twin; what the two classes above would do with a real skin."""

    def __init__(self, skin: ohm.Skin, seed: int = 0) -> None:
        self.sheet, self.pair = ohm.skin.PressedSheet(skin), None
        self.resistance, self.random = self.sheet.untouched, np.random.default_rng(seed)

    def connect(self, source: int, sink: int) -> None:
        self.pair = (source, sink)

    def release(self) -> None:
        self.pair = None

    def sample(self) -> tuple[np.ndarray, float]:
        noise = self.random.normal(0, 0.2e-3, ELECTRODES + 1)
        if self.pair is None:
            return noise[:-1], float(noise[-1])
        (a, b), r = self.pair, self.resistance
        current = SUPPLY / (
            r[a, a] + r[b, b] - 2 * r[a, b] + 250.0 + SHUNT
        )  # source 50 ohm, two multiplexers 100 ohm each
        potentials = (r[a] - r[b] - (r[a, b] - r[b, b])) * current + (
            100.0 + SHUNT
        ) * current  # the sink is above ground
        return potentials + noise[:-1], current * SHUNT + float(noise[-1])

    def close(self) -> None:
        self.pair = None


def open_simulated(skin: ohm.Skin) -> MuxDaqDevice:
    """The same device on a simulated board and card."""
    parts = Simulated(skin)
    return _device("rig:simulated", parts, parts)


if __name__ == "__main__":
    checks = check_device(open_simulated(ohm.Skin.load("paper")))
    print("\n".join(map(str, checks)))
    sys.exit(any(check.outcome == "failed" for check in checks))
