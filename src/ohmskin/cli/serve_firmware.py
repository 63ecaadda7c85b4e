"""``ohmskin serve-firmware``: the real firmware, emulated, on a virtual skin."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ohmskin.cli.options import asked_to_stop, check_seed
from ohmskin.device.firmware import EmulatedBoard
from ohmskin.skin import Skin

_POLL = 0.1  # s, how soon Ctrl-C is heeded


def serve_firmware(
    *,
    skin: str = "paper",
    image: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 7155,
    press_port: int = 7156,
    seed: int | None = None,
    averages: int = 1,
    lifeline: Annotated[bool, Parameter(show=False)] = False,
) -> None:
    """Run the board's firmware in QEMU, with the physics twin as its analogue side.

    Args:
        skin: A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.
        image: The firmware; the one that `make -C firmware qemu` builds unless given.
        host: Address to listen at.
        port: TCP port of the firmware's UART, for one host at a time; 0 takes a free one.
        press_port: TCP port for `ohmskin press`; 0 takes a free one.
        seed: Seed of the noise, to make it repeatable.
        averages: Samples that the firmware makes one value of.
        lifeline: End when standard input ends.
    """
    check_seed(seed)
    stop = asked_to_stop(lifeline)
    with EmulatedBoard(Skin.load(skin), image, host, port, press_port, seed, averages) as board:
        print(f"firmware on a virtual skin {skin!r} at {board.url}", flush=True)
        print(f"press it at {board.press_url}", flush=True)
        while not stop.is_set():
            board.wait(_POLL)
