"""The virtual skin as a device: the physics twin behind the wire protocol, in a process of its own."""

import os
import re
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ohmskin.child import Child
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.wire import WireDevice
from ohmskin.errors import DeviceLost, DeviceRefused, ModelError, SkinError
from ohmskin.scan import DrivePattern, Frame, FrameFlag
from ohmskin.skin import Fault, Skin, VirtualSkin


class VirtualInstrument:
    """The `Instrument` of a `VirtualSkin`, as slow as a real one. What `ohmskin serve-skin` serves.

    Args:
        skin: What to simulate.
        seed: Seed of the noise.
        realtime: Whether a scan takes as long as settling and conversion do; otherwise it returns at once.
        faults: What is wrong with its wiring.
    """

    def __init__(
        self, skin: Skin, seed: int | None = None, realtime: bool = True, faults: Sequence[Fault] = ()
    ) -> None:
        self._skin = VirtualSkin(skin, seed, faults)
        self._realtime = realtime
        self.capabilities = twin_capabilities(skin, f"virtual {skin.name}", skin.converter.conversion)

    def scan(self, pattern: DrivePattern) -> Frame:
        started = time.monotonic()
        frame = self._skin.scan(pattern)
        if self._realtime and (left := started + self._skin.duration(pattern) - time.monotonic()) > 0:
            time.sleep(left)
        first = FrameFlag.FIRST if frame.sequence == 1 else FrameFlag(0)
        return replace(frame, time=time.monotonic(), flags=frame.flags | first)

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        try:
            self._skin.press(number, x, y, radius, pressure)
        except (SkinError, ModelError) as error:
            raise DeviceRefused(str(error)) from error


def twin_capabilities(skin: Skin, name: str, conversion_time: float) -> Capabilities:
    """Capabilities of an instrument that simulates a skin; another boot number each time."""
    source = Feature.VOLTAGE_SOURCE if skin.excitation.source == "voltage" else Feature(0)
    beside = Feature.AUXILIARY if skin.auxiliary.kind else Feature(0)
    return Capabilities(
        name=name.encode()[:32].decode(errors="ignore"),
        n_electrodes=len(skin.electrodes),
        max_injections=256,
        max_measurements=4096,
        pattern_slots=16,
        features=Feature.VIRTUAL | Feature.CURRENT_MEASURED | Feature.DRIVEN_MEASURED | source | beside,
        excitation=skin.excitation.amplitude,
        full_scale=skin.converter.full_scale,
        settle_time=skin.converter.settle,
        conversion_time=conversion_time,
        serial=zlib.crc32(skin.dump().encode()),
        boot=int.from_bytes(os.urandom(4), "little"),
    )


class VirtualDevice(WireDevice):
    """Starts ``ohmskin serve-skin`` and drives it over TCP; both end together.

    Args:
        url: ``virtual:`` and the name or file of a skin; the paper's unless given.
        skin: The skin itself, instead of its name.
        seed: Seed of the noise.
        port: TCP port; a free one unless given.
        realtime: See `VirtualInstrument`.
        faults: What is wrong with its wiring.
        meanwhile: Called while its process starts, which takes seconds.

    Raises:
        DeviceLost: If the process does not come up.
    """

    def __init__(
        self,
        url: str,
        skin: Skin | None = None,
        seed: int | None = None,
        port: int = 0,
        realtime: bool = True,
        faults: Sequence[Fault] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        source = url.partition(":")[2] or "paper"
        command = [sys.executable, "-m", "ohmskin", "serve-skin", "--port", str(port), "--lifeline"]
        command += ["--seed", str(seed)] if seed is not None else []
        command += [] if realtime else ["--no-realtime"]
        for fault in faults:
            command += ["--fault", str(fault)]
        with tempfile.TemporaryDirectory() as folder:
            if skin is not None:
                source = str(Path(folder) / "skin.toml")
                Path(source).write_text(skin.dump(), encoding="utf-8")
            self._child = Child([*command, "--skin", source], "the virtual skin", stderr=subprocess.PIPE)
            try:
                meanwhile()
                super().__init__(address := self._address())
            except BaseException:
                self._child.close(0.0)
                raise
        self.url, self.address = url, address  # the second one is where others reach it, for `ohmskin press`

    def _address(self) -> str:
        for line in self._child.stdout:
            if found := re.search(r"tcp://\S+", line.decode()):
                return found[0]
        errors = self._child.process.stderr
        assert errors is not None
        why = errors.read().decode(errors="replace").lstrip(".\n").strip()  # but its signs of life
        raise DeviceLost(f"the virtual skin did not start: {why or 'no reason given'}")

    def _close(self) -> None:
        super()._close()
        self._child.close(2.0)
