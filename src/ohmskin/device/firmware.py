"""The firmware itself, in the loop: QEMU runs it, the physics twin is its analogue side, hosts reach it over TCP."""

import os
import shutil
import socket
import subprocess
import threading
import time
from contextlib import ExitStack
from pathlib import Path

from ohmskin.child import Child
from ohmskin.closing import Closing
from ohmskin.device.analogue import AnalogueSide
from ohmskin.device.server import DeviceServer, listen
from ohmskin.errors import DeviceError, DeviceLost
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
        averages: Samples that the firmware averages to one value.

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
        command = [_emulator(), "-machine", _MACHINE, "-display", "none", "-kernel", str(_image(image))]
        self._analogue = AnalogueSide(skin, seed, averages)
        with ExitStack() as undo:
            self._press_server = undo.enter_context(DeviceServer(self._analogue, host, press_port))
            self.press_url = self._press_server.url
            with listen(host, port) as listener:
                self.url = f"tcp://{host}:{listener.getsockname()[1]}"
                self._start(command, listener)
            undo.callback(self.close)
            self._await_firmware()
            undo.pop_all()

    def _start(self, command: list[str], listener: socket.socket) -> None:
        self._line, analogue_end = socket.socketpair()
        self._monitor, monitor_end = socket.socketpair()
        with analogue_end, monitor_end:
            ends = (listener, analogue_end, monitor_end)
            command += [
                *("-chardev", f"socket,id=host,fd={listener.fileno()},server=on,wait=off,nodelay=on"),
                *("-chardev", f"socket,id=analogue,fd={analogue_end.fileno()}"),
                *("-chardev", f"socket,id=monitor,fd={monitor_end.fileno()}"),
                *("-serial", "chardev:host", "-serial", "chardev:analogue", "-monitor", "chardev:monitor"),
            ]
            command, fds = ["sh", "-c", _LIFELINE, "lifeline", *command], [end.fileno() for end in ends]
            quiet, told = subprocess.DEVNULL, subprocess.PIPE
            self._child = Child(command, "the emulator", stdout=quiet, stderr=told, pass_fds=fds)
        self._thread = threading.Thread(target=self._analogue.serve, args=(self._line,), daemon=True, name="analogue")
        self._thread.start()

    def _await_firmware(self) -> None:
        end = time.monotonic() + _START
        while not self._analogue.described.wait(_POLL):
            self.wait(0)
            if time.monotonic() > end:
                raise DeviceLost(f"the firmware did not start within {_START:g} s; build it for {_MACHINE}")

    def reset(self) -> None:
        """Press the board's reset button."""
        try:
            self._monitor.sendall(b"system_reset\n")
        except OSError as error:
            raise self._ended() from error

    def wait(self, seconds: float) -> None:
        """Wait, and raise DeviceLost if the emulator ends meanwhile."""
        self._thread.join(seconds)
        if not self._thread.is_alive():
            raise self._ended()

    def close(self) -> None:
        """End the emulator. Safe to call twice."""
        self._press_server.close()
        self._child.close(_STOP)
        self._line.close()
        self._monitor.close()
        self._thread.join()

    def _ended(self) -> DeviceLost:
        errors = self._child.process.stderr
        assert errors is not None
        os.set_blocking(errors.fileno(), False)
        said = (errors.read() or b"").decode(errors="replace").strip()
        return DeviceLost(f"the emulator exited: {said or 'no reason given'}")


def _emulator() -> str:
    if (found := shutil.which(_EMULATOR)) is None:
        raise DeviceError(f"the board's emulator, {_EMULATOR}, is missing: apt-get install qemu-system-arm")
    return found


def _image(given: Path | None) -> Path:
    image = given or _BUILT
    if not image.is_file():
        raise DeviceError(
            f"no firmware at {image}; build it in ohmskin's source tree: make -C firmware qemu "
            "(it needs the Debian packages gcc-arm-none-eabi and libnewlib-arm-none-eabi)"
        )
    return image
