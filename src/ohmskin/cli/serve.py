"""``ohmskin serve-skin`` and ``ohmskin serve-firmware``: the virtual device, and the real firmware, emulated, on it."""

from pathlib import Path

from ohmskin.cli.options import Flag, Lifeline, Seed, SkinName, Stop
from ohmskin.device.firmware import EmulatedBoard
from ohmskin.device.server import DeviceServer
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.forward.assembly import uncompiled
from ohmskin.skin import Fault, Skin

_POLL = 0.1  # s, how soon Ctrl-C is heeded


def serve_skin(
    *,
    skin: SkinName = "paper",
    host: str = "127.0.0.1",
    port: int = 7155,
    pty: Flag = False,
    seed: Seed = None,
    realtime: bool = True,
    fault: tuple[str, ...] = (),
    lifeline: Lifeline = False,
) -> None:
    """Serve a virtual skin: the physics twin behind the wire protocol.

    Args:
        host: Address to listen at.
        port: TCP port; 0 takes a free one.
        pty: Also serve on a pseudo-terminal, like a device on a serial port.
        realtime: Let a scan take as long as on the instrument.
        fault: Fault of the wiring, such as "open 3", "short 7 8", "swap 1 2" or "high 5 20" (20 times the
            contact impedance); give it once for each.
    """
    stop = Stop(lifeline)
    with uncompiled():
        instrument = VirtualInstrument(Skin.load(skin), seed, realtime, [Fault.parse(text) for text in fault])
    with DeviceServer(instrument, host=host, port=port, pty=pty) as server:
        stop.listen()
        print(f"virtual skin {skin!r} at {server.url}", flush=True)
        if server.pty_path:
            print(f"and at serial://{server.pty_path}", flush=True)
        stop.wait()


def serve_firmware(
    *,
    skin: SkinName = "paper",
    image: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 7155,
    press_port: int = 7156,
    seed: Seed = None,
    averages: int = 1,
    lifeline: Lifeline = False,
) -> None:
    """Run the board's firmware in QEMU, with the physics twin as its analogue side.

    Args:
        image: The firmware; the one that `make -C firmware qemu` builds unless given.
        host: Address to listen at.
        port: TCP port of the firmware's UART, for one host at a time; 0 takes a free one.
        press_port: TCP port for `ohmskin press`; 0 takes a free one.
        averages: Number of samples that the firmware averages for one value.
    """
    stop = Stop(lifeline)
    with EmulatedBoard(Skin.load(skin), image, host, port, press_port, seed, averages) as board:
        stop.listen()
        print(f"firmware on a virtual skin {skin!r} at {board.url}", flush=True)
        print(f"press it at {board.press_url}", flush=True)
        while not stop:
            board.wait(_POLL)
