"""``ohmskin serve-skin``: the virtual device."""

from typing import Annotated

from cyclopts import Parameter

from ohmskin.cli.options import asked_to_stop, check_seed
from ohmskin.device.server import DeviceServer
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.skin import Fault, Skin


def serve_skin(
    *,
    skin: str = "paper",
    host: str = "127.0.0.1",
    port: int = 7155,
    pty: bool = False,
    seed: int | None = None,
    realtime: bool = True,
    fault: tuple[str, ...] = (),
    lifeline: Annotated[bool, Parameter(show=False)] = False,
) -> None:
    """Serve a virtual skin: the physics twin behind the wire protocol.

    Args:
        skin: A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.
        host: Address to listen at.
        port: TCP port; 0 takes a free one.
        pty: Also serve on a pseudo-terminal, like a board on a serial port.
        seed: Seed of the noise, to make it repeatable.
        realtime: Take as long for a scan as the instrument would.
        fault: Something wrong with the wiring, such as "open 3", "short 7 8", "swap 1 2" or "high 5 20" (20 times the
            contact impedance); give it once for each.
        lifeline: End when standard input ends.
    """
    check_seed(seed)
    stop = asked_to_stop(lifeline)
    instrument = VirtualInstrument(Skin.load(skin), seed, realtime, [Fault.parse(text) for text in fault])
    with DeviceServer(instrument, host=host, port=port, pty=pty) as server:
        print(f"virtual skin {skin!r} at {server.url}", flush=True)
        if server.pty_path:
            print(f"and at serial://{server.pty_path}", flush=True)
        stop.wait()
