"""``ohmskin replay``: a recording through the loop and the page again, or as other estimators see it."""

import math
from pathlib import Path

import numpy as np

from ohmskin.cli.live import live
from ohmskin.cli.options import (
    AS_THE_MODE,
    HERE,
    Flag,
    Imaging,
    Page,
    Seconds,
    check_picture,
    check_recording,
    refuse_unused,
    watched,
)
from ohmskin.errors import OhmskinError
from ohmskin.inverse.estimators import image_of


def replay(
    file: Path,
    *,
    skin: str = "",
    mode: str = "",
    imaging: Imaging = AS_THE_MODE,
    speed: float = 1.0,
    start: float = 0.0,
    loop: Flag = False,
    rate: float = 30.0,
    compare: str = "",
    at: float | None = None,
    output: Path | None = None,
    page: Page = HERE,
    headless: Flag = False,
    json: Flag = False,
    seconds: Seconds = None,
) -> None:
    """Replay a recording through the same loop and page as a device, or compare estimators on it.

    Args:
        file: The recording: of ohmskin (.mcap), or a table or MATLAB file of other programs.
        skin: Skin to use instead of the recorded one.
        mode: Mode to use instead of the recorded ones, if its scans were recorded.
        speed: Seconds of the recording per second; inf: as fast as possible.
        start: Start time (s from the first frame after the calibration).
        loop: Start again at the end.
        rate: Frames per second of recordings without times.
        compare: Estimators or priors, such as paper,matern,total-variation,absolute:matern: no page, a picture of their
            images side by side.
        at: With --compare: time (s) to show; that of the strongest contact unless given.
        output: With --compare: picture to write; the recording's name in this folder unless given.
        headless: No page: contacts as a table on the terminal.
        json: No page: a line of JSON for every frame.
    """
    check_recording(file)
    if compare:
        page.check("--compare")
        played = {"speed": speed != 1, "start": start != 0, "rate": rate != 30, "loop": loop}
        refuse_unused("with --compare", **played, headless=headless, json=json, seconds=seconds is not None)
        if imaging != AS_THE_MODE:
            raise OhmskinError("--compare names estimators and priors itself, such as --compare kalman:matern")
        _compare(file, compare.split(","), at, mode, skin, output or Path(f"{file.stem}.compare.png"))
        return
    if at is not None or output is not None:
        raise OhmskinError("--at and --output go with --compare, such as --compare paper,matern")
    if not (speed > 0 and not math.isnan(speed)):
        raise OhmskinError(f"--speed is {speed:g}; it must be positive, or inf")
    live(
        device=f"replay:{file}?speed={speed}&start={start}&loop={int(loop)}&rate={rate}",
        skin=skin,
        mode=mode,
        imaging=imaging,
        page=page,
        demo=False,
        headless=headless,
        json=json,
        seconds=seconds,
    )


def _compare(file: Path, names: list[str], at: float | None, mode: str, skin: str, output: Path) -> None:
    from ohmskin.recording.export import cycle_at, save_comparison, strongest
    from ohmskin.recording.player import reimage

    chosen = {name: image_of(name) for name in names}
    if output.exists():
        raise OhmskinError(f"{output} exists and is never overwritten; choose another with --output")
    check_picture(output)
    if at is None:
        at = strongest(watched(reimage(file, mode=mode, skin=skin))).time
    cycles = {}
    for name, (estimator, prior) in chosen.items():
        cycles[name] = cycle = cycle_at(file, at, estimator=estimator, prior=prior, mode=mode, skin=skin)
        found = [1e3 * np.array(contact.position) for contact in cycle.touch.percept.detections]
        places = ", ".join(f"({x:.1f}, {y:.1f}) mm" for x, y in found)
        print(f"{name:10s} {places or 'no contact'}")
    save_comparison(output, {f"{name}, {cycle.time:.2f} s": cycle for name, cycle in cycles.items()})
    print(f"picture: {output}")
