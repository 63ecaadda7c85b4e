"""``ohmskin image``: a picture of a recording."""

import sys
from itertools import islice
from pathlib import Path

from ohmskin.drive import Mode
from ohmskin.engine import Perception
from ohmskin.errors import DataError
from ohmskin.inverse import match_model
from ohmskin.plot import save_picture
from ohmskin.publish.export import write_picture
from ohmskin.publish.player import reimage
from ohmskin.record import is_tape, read_recording
from ohmskin.scan import assess, left_out
from ohmskin.skin import Skin, shipped_skins


def image(
    file: Path,
    *,
    skin: str = "",
    output: Path | None = None,
    reference: Path | None = None,
    pattern: Path | None = None,
    frame: int = 0,
) -> None:
    """Make a picture of a recording's frame, with its contacts, and say what its data are worth.

    Parameters
    ----------
    file
        The recording: ours (.mcap), a MATLAB file of EIDORS, UEF 2017 or KTC 2023, or a table (.csv) with a pattern.
    skin
        A skin that ships with ohmskin or a .toml file; the one that fits the format unless given.
    output
        Where to put the picture; beside the recording's name in this folder unless given.
    reference
        File of the untouched skin, for formats that keep it apart; the usual name beside the recording unless given.
    pattern
        Table of electrodes, for a table without one; NAME.pattern.csv beside it unless given.
    frame
        Which frame of the recording, or which cycle of one of ours (.mcap), from 0.
    """
    if is_tape(file):
        _image_cycle(file, skin, output or Path(file.stem + ".png"), frame)
        return
    recording = read_recording(file, reference=reference, pattern=pattern)
    if not 0 <= frame < len(recording.frames):
        raise DataError(f"--frame {frame}: {file} has frames 0 to {len(recording.frames) - 1}")
    if not (skin or recording.skin):
        raise DataError(f"{file} does not say what was measured; name it with --skin, a .toml file or {', '.join(shipped_skins())}")
    description = Skin.load(skin or recording.skin)
    shown = recording.frames[frame]
    shown.pattern.check(len(description.electrodes))
    quality = assess(recording.quiet, [shown])
    model = description.transfer_model()
    perception = Perception(description, model, recording.quiet, quality)
    missing = left_out(perception.baseline.difference(quality.clean(shown)))
    match = match_model(model, quality.clean(recording.quiet[0]))
    for line in [*recording.notes, *quality.report(), *([missing] if missing else []), *match.report()]:
        print(f"# {line}", file=sys.stderr)
    mode = Mode("recorded", "the recording's own pattern", shown.pattern)
    perception.learn_thresholds(mode, lambda _: recording.quiet[0], len(recording.quiet))
    sight = perception.see(mode, lambda _: shown)
    target = output or Path(file.stem + ".png")
    mesh, electrodes = perception.model.mesh, description.electrodes
    title = f"{file.parent.name.replace('_', ' ')} {file.stem if file.suffix == '.mat' else ''}".strip()
    save_picture(target, mesh, sight.image.values, electrodes, sight.contacts, title)
    for contact in sight.contacts:
        x, y = contact.position
        change = "conducts better" if contact.strength > 0 else "conducts worse"
        print(
            f"({x * 1e3:6.1f}, {y * 1e3:6.1f}) mm  {contact.extent * 1e4:5.2f} cm2  {change}, confidence {contact.confidence:.2f}"
        )
    if not sight.contacts:
        print("nothing above the threshold")
    print(f"picture: {target}")


def _image_cycle(file: Path, skin: str, target: Path, number: int) -> None:
    cycle = next(islice(reimage(file, skin=skin), max(number, 0), None), None)
    if cycle is None or number < 0:
        raise DataError(
            f"--frame {number}: {file} has fewer cycles; `ohmskin export {file} --to png --at SECONDS` finds one by time"
        )
    write_picture(target, cycle)
    for contact in cycle.touch.sight.contacts:
        x, y = contact.position
        print(f"({x * 1e3:6.1f}, {y * 1e3:6.1f}) mm  {contact.extent * 1e4:5.2f} cm2, confidence {contact.confidence:.2f}")
    if not cycle.touch.sight.contacts:
        print("nothing above the threshold")
    print(f"picture: {target}")
