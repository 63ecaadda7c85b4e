"""``ohmskin export``: recordings as tables, arrays, pictures and films."""

import sys
from pathlib import Path
from typing import Literal

import numpy as np

from ohmskin.cli.options import check_plot, check_recording, watched
from ohmskin.errors import DataError, OhmskinError
from ohmskin.mcap import RecordingReader, is_recording
from ohmskin.recording import export as exporting
from ohmskin.recording.player import reimage

_RATE = 25.0  # 1/s


def export(
    file: Path,
    *,
    to: Literal["csv", "npz", "parquet", "png", "mp4"],
    output: Path | None = None,
    what: Literal["contacts", "frames"] = "contacts",
    start: float | None = None,
    seconds: float | None = None,
    at: float | None = None,
    mode: str = "",
    skin: str = "",
    rate: float = _RATE,
) -> None:
    """Write a recording as csv, npz, parquet, png or mp4; columns and units are in docs/guide/recording.md.

    Args:
        file: The recording.
        to: csv and parquet: a table; npz: everything as NumPy arrays; png: a picture; mp4: a video (needs ffmpeg).
        output: File to write; the recording's name in this folder unless given. No file is ever overwritten.
        what: Which table: contacts (a row per contact and cycle) or frames (a row per voltage).
        start: Start time (s from the first frame after the calibration); the calibration is included unless given.
        seconds: Duration (s); to the end unless given.
        at: png: time (s) to show; that of the strongest contact unless given.
        mode: png, mp4: mode to use instead of the recorded ones, if its scans were recorded.
        skin: png, mp4: skin to use instead of the recorded one.
        rate: mp4: pictures per second.
    """
    check_recording(file)
    if (start is not None and not start >= 0) or (seconds is not None and not seconds > 0):
        raise OhmskinError("--start must be 0 or more and --seconds positive")
    for name, given, kinds in (
        ("--at", at is not None, ("png",)),
        ("--mode", bool(mode), ("png", "mp4")),
        ("--skin", bool(skin), ("png", "mp4")),
        ("--rate", rate != _RATE, ("mp4",)),
        ("--what", what != "contacts", ("csv", "parquet")),
    ):
        if given and to not in kinds:
            raise OhmskinError(f"{name} is for --to {' or '.join(kinds)}; leave it out for {to}")
    if not 0 < rate <= 240:
        raise OhmskinError(f"--rate is {rate:g}; it must be above 0 and at most 240")
    stop = (start or 0.0) + seconds if seconds is not None else np.inf
    suffix = f".{what}.{to}" if to in ("csv", "parquet") else f".{to}"
    target = output or Path(file.stem + suffix)
    if target.exists():
        raise OhmskinError(f"{target} exists and is never overwritten; choose another with --output")
    if to in ("png", "mp4"):
        check_plot()
        cycles = watched(reimage(file, mode=mode, skin=skin, start=start or 0.0, stop=stop))
        if to == "mp4":
            print(f"video of {exporting.write_video(target, cycles, rate)} pictures: {target}")
            return
        cycle = exporting.strongest(cycles) if at is None else exporting.cycle_at(file, at, mode=mode, skin=skin)
        exporting.save_comparison(target, {f"{cycle.time:.2f} s": cycle})
        print(f"picture of {cycle.time:.2f} s: {target}")
        return
    if not is_recording(file):
        raise DataError(f"{file} is not a recording of ohmskin (.mcap); others can be exported as png and mp4")
    begin = -np.inf if start is None else start
    with RecordingReader(file) as reader:
        for note in reader.notes:
            print(f"# {note}", file=sys.stderr)
        if begin > (end := reader.times.max(initial=0.0)):
            raise DataError(f"--start {begin:g}: the recording has 0 to {end:g} s")
        if to == "npz":
            shapes = exporting.write_npz(target, reader, begin, stop)
            print(f"{target}: {', '.join(f'{name} {shape}' for name, shape in shapes.items() if len(shape))}")
            return
        columns = exporting.CONTACT_COLUMNS if what == "contacts" else exporting.FRAME_COLUMNS
        rows = (exporting.contact_rows if what == "contacts" else exporting.frame_rows)(reader, begin, stop)
        write = exporting.write_csv if to == "csv" else exporting.write_parquet
        print(f"{target}: {write(target, columns, rows)} rows of {', '.join(columns)}")
