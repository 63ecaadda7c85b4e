"""``ohmskin electrodes``: place a skin's electrodes by clicking on it."""

import time
from pathlib import Path

from ohmskin.cli.options import HERE, Page, Seconds, SkinName, Stop, check_writable
from ohmskin.skin import Skin
from ohmskin.view.placing import PlacementPage

_EVERY = 0.1  # s


def electrodes(
    *, skin: SkinName = "paper", save: Path | None = None, page: Page = HERE, seconds: Seconds = None
) -> None:
    """Place electrodes by clicking on the skin in space; a button on the page writes the skin file.

    Args:
        save: Skin file to write; SKIN-electrodes.toml in this folder unless given. It may be the skin's own file; a
            file that was there is kept under another name, as the new one has no calibration.
    """
    described = Skin.load(skin)
    target = save or Path(f"{described.name}-electrodes.toml")
    check_writable(target)
    page.check()
    stop = Stop()
    with PlacementPage(described, target, *page.address) as placing:
        page.open(placing.url)
        end = float("inf") if seconds is None else time.monotonic() + seconds
        stop.listen()
        while not stop and time.monotonic() < end:
            stop.wait(_EVERY)
