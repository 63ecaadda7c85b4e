"""The firmware itself, in the loop: QEMU runs it, the physics twin is its analogue side, hosts reach it over TCP."""

import os
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path

from ohmskin.child import Child
from ohmskin.closing import Closing
from ohmskin.device.analogue import AnalogueSide
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.server import DeviceServer, listen
from ohmskin.errors import DeviceError, DeviceLost, DeviceRefused, SkinError
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Skin

_EMULATOR, _MACHINE = "qemu-system-arm", "stm32vldiscovery"
_START = 20.0  # s, on a computer busy with other things
_STOP = 5.0  # s
_POLL = 0.05  # s
_BUILT = Path(__file__).parents[3] / "firmware" / "build" / "ohmskin-qemu.elf"

# The shell ends the emulator as soon as its standard input closes, however we end; and itself when the emulator does.
_LIFELINE = """
exec 3<&0
"$@" </dev/null 3<&- & board=$!
{ read -r _ <&3; kill -9 $board; } & reader=$!
wait $board
kill $reader
"""


class EmulatedBoard(Closing):
    """A board made of the real firmware and a made-up skin.

    A host has the board to itself, as it would have a serial port: a second one waits until the first has gone.
    Touches that come from elsewhere (`ohmskin press` beside `ohmskin live`) go to `press_url`, straight to the twin.

    Args:
        skin: What its electrodes are connected to.
        image: The firmware (ELF); the one that `make -C firmware qemu` builds unless given.
        host: Address to listen at.
        port: TCP port of the firmware's UART; 0 takes a free one.
        press_port: TCP port for touches from elsewhere; 0 takes a free one.
        seed: Seed of the noise.
        averages: Samples that the firmware makes one value of.

    Raises:
        DeviceError: If QEMU or the firmware is missing, or a port is in use.
        DeviceLost: If the firmware does not start.
        SkinError: If the skin does not fit the board.
    """

    def __init__(
        self,
        skin: Skin,
        image: Path | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        press_port: int = 0,
        seed: int | None = None,
        averages: int = 1,
    ) -> None:
        self._command = [_emulator(), "-machine", _MACHINE, "-display", "none", "-kernel", str(_image(image))]
        self._analogue = AnalogueSide(skin, seed, averages)
        self._press_server = DeviceServer(_PressOnly(self._analogue), host, press_port)
        self.press_url = self._press_server.url
        try:
            with listen(host, port) as listener:
                self.url = f"tcp://{host}:{listener.getsockname()[1]}"
                self._start(listener)
        except BaseException:
            self._press_server.close()
            raise
        self._press_server.start()
        try:
            self._await_firmware()
        except BaseException:
            self.close()
            raise

    def _start(self, listener: socket.socket) -> None:
        self._line, analogue_end = socket.socketpair()
        self._monitor, monitor_end = socket.socketpair()
        with analogue_end, monitor_end:
            ends = (listener, analogue_end, monitor_end)
            self._command += [
                *("-chardev", f"socket,id=host,fd={listener.fileno()},server=on,wait=off,nodelay=on"),
                *("-chardev", f"socket,id=analogue,fd={analogue_end.fileno()}"),
                *("-chardev", f"socket,id=monitor,fd={monitor_end.fileno()}"),
                *("-serial", "chardev:host", "-serial", "chardev:analogue", "-monitor", "chardev:monitor"),
            ]
            self._child = Child(
                ["sh", "-c", _LIFELINE, "lifeline", *self._command],
                "the emulator",
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=[end.fileno() for end in ends],
            )
        self._thread = threading.Thread(target=self._analogue.serve, args=(self._line,), daemon=True, name="analogue")
        self._thread.start()

    def _await_firmware(self) -> None:
        end = time.monotonic() + _START
        while not self._analogue.described.wait(_POLL):
            self.wait(0)
            if time.monotonic() > end:
                raise DeviceLost(f"the firmware did not start within {_START:g} s; is it made for {_MACHINE}?")

    @property
    def alive(self) -> bool:
        """Whether the emulator still runs."""
        return self._thread.is_alive()

    def reset(self) -> None:
        """Press the board's reset button."""
        try:
            self._monitor.sendall(b"system_reset\n")
        except OSError as error:
            raise DeviceLost(f"the emulator has ended: {self._complaint()}") from error

    def wait(self, seconds: float) -> None:
        """Wait, and raise DeviceLost if the emulator ends meanwhile."""
        self._thread.join(seconds)
        if not self.alive:
            raise DeviceLost(f"the emulator has ended: {self._complaint()}")

    def close(self) -> None:
        """End the emulator. Safe twice."""
        self._press_server.close()
        self._child.close(_STOP)
        self._line.close()
        self._monitor.close()
        self._thread.join()

    def _complaint(self) -> str:
        errors = self._child.process.stderr
        assert errors is not None
        os.set_blocking(errors.fileno(), False)
        said = errors.read() or b""
        return said.decode(errors="replace").strip() or "it gave no reason"


class _PressOnly:
    """Takes touches for the twin, and refuses to scan: that is the firmware's part."""

    def __init__(self, analogue: AnalogueSide) -> None:
        self._analogue = analogue
        count = len(analogue.skin.electrodes)
        name = f"fingers on {analogue.skin.name}".encode()[:32].decode(errors="ignore")
        self.capabilities = Capabilities(name, count, 1, 1, 1, Feature.VIRTUAL)

    def scan(self, pattern: DrivePattern) -> Frame:
        raise DeviceRefused("this port takes touches only; scan the firmware's own port")

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        try:
            self._analogue.press_elsewhere(number, x, y, radius, pressure)
        except SkinError as error:
            raise DeviceRefused(str(error)) from error


def _emulator() -> str:
    if (found := shutil.which(_EMULATOR)) is None:
        raise DeviceError(f"{_EMULATOR} is missing, the board's emulator: apt-get install qemu-system-arm")
    return found


def _image(given: Path | None) -> Path:
    image = given or _BUILT
    if not image.is_file():
        raise DeviceError(
            f"no firmware at {image}; build it in ohmskin's source tree: make -C firmware qemu "
            "(it needs the Debian packages gcc-arm-none-eabi and libnewlib-arm-none-eabi)"
        )
    return image
