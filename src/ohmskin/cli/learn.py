"""``ohmskin learn``: what a recording of presses says of a skin."""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

import ohmskin
from ohmskin.calibrate.channels import judge_channels
from ohmskin.calibrate.positions import learn_positions, read_places
from ohmskin.cli.options import SkinName, check_picture, check_writable, fitting_skin, write_skin
from ohmskin.errors import DataError
from ohmskin.importers import read_recording, resolved
from ohmskin.inverse import match_model
from ohmskin.scan import Baseline
from ohmskin.sensing import SkinModel


def learn(
    file: Path,
    *,
    skin: SkinName = "",
    output: Path | None = None,
    picture: Path | None = None,
    reference: Path | None = None,
    pattern: Path | None = None,
    channels: bool = True,
    positions: bool = True,
) -> None:
    """Learn from a recording of presses which channels follow the skin's model and, where places are known, a map.

    Args:
        file: Frames of one press each: press data (.csv or .mat, see the guide), or any recording that `image` reads.
        skin: A skin that ships with ohmskin or a .toml file; the one that fits the format unless given.
        output: File for the learned skin; NAME-learned.toml unless given. One that is there is kept under another name.
        picture: Also save the channels, and the errors of the map, as a picture, such as learned.png.
        reference: File of the untouched skin, for formats that keep it apart; beside the recording unless given.
        pattern: Table of electrodes, for a table without one; NAME.pattern.csv beside it unless given.
        channels: Whether to judge the channels; --no-channels keeps those of the skin.
        positions: Whether to learn a map of positions, if places are known.
    """
    if picture is not None:
        check_picture(picture)
    recording = read_recording(file, reference=reference, pattern=pattern)
    description = fitting_skin(file, skin, recording.skin)
    path = output or Path(f"{description.name}-learned.toml")
    check_writable(path)
    if not recording.frames:
        raise DataError(f"{file} has frames of the untouched skin only")
    recording.frames[0].pattern.check(len(description.electrodes))
    recorded, model = recording.values, description.transfer_model()
    recording = resolved(recording, model)
    doubts = [] if recorded == "differences" else match_model(model, recording.quiet[0]).report()
    for line in (*recording.notes, *doubts):
        print(f"# {line}", file=sys.stderr)
    found = description.calibration.made_now(description.digest, ohmskin.__version__)
    judged = report = None
    with threadpool_limits(1, "blas"), Progress(console=Console(stderr=True), transient=True) as shown:

        def progress(words: str) -> Callable[[float], None]:
            task = shown.add_task(words, total=1.0)
            return lambda share: shown.update(task, completed=share)

        if channels:
            judged = judge_channels(description, recording.quiet, recording.frames, progress("judging channels"))
            resting = None  # of differences it is the model's
            if recorded != "differences":
                resting = Baseline.learn(recording.quiet).reference(judged.pattern)
            found = judged.put_into(found, resting)
        places = recording.positions if positions else None
        if places is not None and not np.isfinite(places).all(axis=1).any():
            print("# no press has a place: no map is learned", file=sys.stderr)
            places = None
        if places is not None:
            unmapped = replace(description, calibration=replace(found, position_map=""))
            known = SkinModel(unmapped, model, recording.quiet)
            at, changes = read_places(known, recording.frames, progress("reading presses"))
            x0, y0, x1, y1 = description.domain.bounds
            size, told = max(x1 - x0, y1 - y0), progress("learning positions")
            report = learn_positions(recording.frames[0].pattern, at, changes, places, size, told)
            found = replace(found, position_map=report.map.dump())
    for one in (judged, report):
        print("\n".join(one.report() if one is not None else ()), end="\n" if one is not None else "")
    write_skin(path, replace(description, calibration=found))
    mode = "" if report is None else f", in mode {len(description.electrodes)}L or any whose contacts are fitted"
    print(f"wrote {path}; use it with --skin {path}{mode}")
    if picture is not None:
        from ohmskin.plot.learned import save_learned  # here: it needs the extra `plot`

        save_learned(picture, description, judged, report, recording.positions)
        print(f"picture: {picture}")
