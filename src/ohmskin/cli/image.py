"""``ohmskin image``: a picture of a recording."""

import json as json_module
import sys
from collections.abc import Sequence
from itertools import islice
from math import sqrt
from pathlib import Path

from ohmskin.cli.options import Flag, check_picture, check_recording, fitting_skin, watched
from ohmskin.client.fields import as_json
from ohmskin.contacts import CLASSES, Segments, evidence, segments
from ohmskin.errors import DataError
from ohmskin.importers import read_recording, resolved
from ohmskin.inverse import match_model
from ohmskin.mcap import is_recording
from ohmskin.plot import save_picture
from ohmskin.plot.picture import full_scale, noise_of
from ohmskin.recording.export import save_comparison, strongest
from ohmskin.recording.player import reimage
from ohmskin.scan import Frame, assess, left_out
from ohmskin.sensing import Percept, SkinModel, perceive, recorded_mode
from ohmskin.sensing.confidence import common_change, common_confidence, crowd_confidence

_DOUBTFUL = 0.1  # share of a frame's change that no image explains, from which on that is told


def image(
    file: Path,
    *,
    skin: str = "",
    output: Path | None = None,
    reference: Path | None = None,
    pattern: Path | None = None,
    frame: int | None = None,
    estimator: str = "gauss-newton",
    prior: str = "paper",
    rule: str = "physical",
    json: Flag = False,
) -> None:
    """Make a picture of a recording's frame, with its contacts, and report the quality of its data.

    Args:
        file: The recording: of ohmskin (.mcap), a MATLAB file of EIDORS, UEF 2017 or KTC 2023, or a .csv with a
            pattern.
        skin: A skin that ships with ohmskin or a .toml file; the one that fits the format unless given.
        output: Picture to write; the recording's name in this folder unless given.
        reference: File of the untouched skin, for formats that keep it apart; beside the recording unless given.
        pattern: Table of electrodes, for a table without one; NAME.pattern.csv beside it unless given.
        frame: Number of the frame, or of the cycle of an ohmskin recording (.mcap), from 0; unless given, the first
            frame, or the cycle with the strongest contact.
        estimator: Estimator of the image, such as kalman or absolute (see `ohmskin info`).
        prior: Prior of the estimator, such as paper or matern.
        rule: Rule for the regularisation parameter, such as physical or l-curve.
        json: Print contacts, areas and evidence as one line of JSON.
    """
    target = output or Path(file.stem + ".png")
    check_picture(target)
    check_recording(file)
    if is_recording(file):
        cycles = reimage(file, estimator, prior, rule, skin=skin)
        if frame is None:
            cycle = strongest(watched(cycles))
        elif frame < 0:
            raise DataError(f"--frame {frame}; it must be 0, the first cycle, or more")
        elif (found := next(islice(cycles, frame, None), None)) is None:
            by_time = f"`ohmskin export {file} --to png --at SECONDS` finds one by time"
            raise DataError(f"--frame {frame}: {file} has fewer cycles; {by_time}")
        else:
            cycle = found
        save_comparison(target, {f"{cycle.time:.2f} s": cycle})
        _print_report(cycle.touch.percept, target, None, {}, json)
        return
    frame = frame or 0
    recording = read_recording(file, reference=reference, pattern=pattern)
    if not 0 <= frame < len(recording.frames):
        raise DataError(f"--frame {frame}: {file} has frames 0 to {len(recording.frames) - 1}")
    description = fitting_skin(file, skin, recording.skin)
    recording.frames[frame].pattern.check(len(description.electrodes))
    model = description.transfer_model()
    repeated = recording.values != "differences" and len(recording.quiet) > 1
    if told := recording.positions is not None:  # press data
        recording = resolved(recording, model)
    shown = recording.frames[frame]
    quality = assess(recording.quiet, [shown])
    known = SkinModel(description, model, recording.quiet, quality)
    missing = left_out(known.baseline.difference(quality.clean(shown)))
    match = match_model(model, quality.clean(recording.quiet[0]))
    checked = quality.report() if repeated or not told else quality.findings  # of data, not of what is assumed
    for line in [*recording.notes, *checked, *([missing] if missing else []), *match.report()]:
        print(f"# {line}", file=sys.stderr)
    percept = perceive(known, shown, recorded_mode(description).using(estimator, prior, rule))
    if percept.belief.unexplained > _DOUBTFUL:
        share = f"{100 * percept.belief.unexplained:.0f} % of the change fits no change of this sheet's conductivity"
        print(f"# {share}: another skin, swapped wires, or bad channels (`ohmskin learn` finds them)", file=sys.stderr)
    factor, alike = common_change(known, [known.difference(shown)])
    if percept.detections and common_confidence(alike) < 1:
        change = f"all voltages changed by {100 * factor:+.2g} %, which explains {100 * alike:.0f} % of the change"
        print(f"# {change}: the conductivity as a whole, as with temperature; contacts are doubtful", file=sys.stderr)
    mesh, electrodes = known.model.mesh, description.electrodes
    if crowd_confidence(count := len(percept.detections), len(electrodes)) < 1:
        many = f"{count} contacts in one image are more than {len(electrodes)} electrodes show"
        print(f"# {many}: noise or errors of the model; regularise more; contacts are doubtful", file=sys.stderr)
    title = f"{file.parent.name.replace('_', ' ')} {file.stem}".strip()
    limit = full_scale(percept)
    noise = known.noise * (1 if len(recording.quiet) > 1 else sqrt(2))  # of a single one, not of a difference
    scans = [known.difference(shown)]
    needed = {} if match.doubtful else evidence(known.model, noise, scans, noise_freedom(recording.quiet))
    how = {"fraction": description.imaging.fraction, "dip": description.imaging.dip}
    classes = segments(percept.image, mesh, needed, **how)
    save_picture(target, mesh, percept.image.values, electrodes, percept.detections, title, limit, classes.labels)
    _print_report(percept, target, classes, classes.areas(mesh), json)


def noise_freedom(quiet: Sequence[Frame]) -> int:
    """Degrees of freedom of the noise estimated from quiet frames: by repeats, or by reciprocity of a single one."""
    return max(len(quiet) - 1, 1) * quiet[0].pattern.n_meas // (1 if len(quiet) > 1 else 2)


def _print_report(
    percept: Percept, target: Path, found: Segments | None, areas: dict[str, float], as_lines: bool
) -> None:
    if as_lines:
        contacts = [as_json(contact) for contact in percept.detections]
        classes = {
            name: {
                "area": areas[name],
                "there": None if one.undecided else one.significant,
                "lost": one.unexplained,
                "needed": one.needed,
            }
            for name, one in ((CLASSES[sign], one) for sign, one in (found.evidence if found else {}).items())
        }
        print(json_module.dumps({"contacts": contacts, "classes": classes, "picture": str(target)}))
        return
    for contact in percept.detections:
        x, y = contact.position
        change = "conducts better" if contact.strength > 0 else "conducts worse"
        size = f"{contact.extent * 1e4:5.2f} cm2  {change}, confidence {contact.confidence:.2f}"
        print(f"({x * 1e3:6.1f}, {y * 1e3:6.1f}) mm  {size}")
    if not percept.detections:
        print(f"no contact; noise +-{100 * noise_of(percept.image):.2g} %")
    for sign, one in found.evidence.items() if found else ():
        more, needed = 100 * one.unexplained, 100 * one.needed
        share = f"without it {more:.2g} % more of the change is unexplained, {needed:.2g} % needed"
        area = f"{1e4 * areas[CLASSES[sign]]:.1f} cm2" if one.significant else "none"
        if one.undecided:
            area = "undecided, as either class alone explains the change"
        print(f"{CLASSES[sign]}: {area}; {share}")
    print(f"picture: {target}")
