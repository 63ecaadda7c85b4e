"""What the drive gives and what the reader gives: every drive with every reader, at equal noise.

    python -m benchmarks.sensors [--seeds 4] [--places 50] [--worlds discs:40 ...] [--output docs/modes.json]

One contact at rest at random places of the paper's sheet, 10 mm and more from its rim, and at 20 places in its corners,
10 to 18 mm from both sides. The sensors are those that a
loop uses, made by name (`ohmskin.sensing.build`) and calibrated on 40 quiet scans of each world of `ohmskin.evaluate`,
none of which is the estimator's own model: discs of raised conductivity (radius 10 mm, +50 %), and patches pressed on
the sheet (8 mm, 20 kPa). Noise is one level for all, in decibels below the largest voltage of the adjacent scan on the
rim. A frame has 28 injections; drives of four a frame are given seven frames. The error is that of the strongest
contact; where none is found, that of the middle of the sheet, and the place counts as missed, as it does beyond 30 mm.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.errors import OhmskinError
from ohmskin.evaluate import worlds
from ohmskin.scan import DrivePattern, Frame, needed
from ohmskin.sensing import Sensor, SkinModel, build, default_mode, drive_of
from ohmskin.skin import Mode, Skin

DRIVES = {  # name and injections a frame, 0 where there is no choice
    "rim": 0, "rings": 0, "opposite": 0, "best, 16": 16, "best, 28": 28,
    "eq7": 28, "local": 28, "position": 28, "rotating": 4, "tracking": 4,
}  # fmt: skip
READINGS = ("centroid", "fit", "tracked", "fit, driven", "tracked, driven")  # driven: those electrodes measured, too
TOTAL = 28  # injections from which a contact is read
QUIET = 40
BEYOND = 30e-3  # m, from where on an error is a miss
MARGIN = 10e-3
CORNERS = 20


class World:
    """A sheet of `ohmskin.evaluate.worlds` that is scanned like a device, with white noise.

    Args:
        kind: One of `worlds.WORLDS`.
        decibels: Noise level.
    """

    def __init__(self, kind: str, decibels: float) -> None:
        self.kind, self.noise = kind, worlds.noise_volts(kind, decibels)
        skin = worlds.skin_of(kind, "grid")
        current = replace(skin.excitation, source="current", amplitude=worlds.CURRENT)
        exact = replace(skin.converter, noise=self.noise, bits=32)
        self.skin = replace(skin, excitation=current, converter=exact)
        self.untouched = worlds.sheet(kind, "grid").untouched
        self.resistance, self._random, self._clock = self.untouched, np.random.default_rng(0), 0.0

    def press(self, place: np.ndarray | None, seed: int) -> None:
        """One contact there, or none; noise from a seed of the place."""
        touched = place is not None
        self.resistance = (
            worlds.touched(self.kind, "grid", (worlds.contact(self.kind, *place),)) if touched else self.untouched
        )
        self._random = np.random.default_rng([seed, *np.round(1e6 * (place if touched else np.zeros(2))).astype(int)])

    def scan(self, pattern: DrivePattern) -> Frame:
        """Voltages at `worlds.CURRENT`."""
        self._clock += pattern.n_inj * 1e-4
        volts = worlds.voltages(self.resistance, pattern) + self.noise * self._random.standard_normal(pattern.n_meas)
        return Frame(pattern, volts, np.full(pattern.n_inj, worlds.CURRENT), self._clock)


def mode(drive: str, reading: str) -> Mode:
    """A drive of the table with a reader."""
    reader, _, driven = reading.partition(", ")
    name, injections = drive.split(",")[0], DRIVES[drive]
    return Mode(f"{drive}, {reading}", name, reader, injections=injections, driven=bool(driven))


def learned(world: World) -> SkinModel:
    """What a calibration learns of a quiet world. Discs have point electrodes, which have no contact impedance."""
    world.press(None, 1)
    modes = [mode(drive, reading) for drive in DRIVES for reading in ("fit", "fit, driven")]
    patterns = needed(pattern for each in modes for pattern in drive_of(each, world.skin).patterns)
    quiet = [world.scan(pattern) for _ in range(QUIET) for pattern in patterns]
    impedances = np.zeros(len(world.skin.electrodes)) if world.kind == "discs" else None
    return SkinModel(world.skin, world.skin.transfer_model(), quiet, impedances=impedances)


def corner_places() -> np.ndarray:
    """As many places in each corner (n, 2), 10 to 18 mm from both sides."""
    inside = np.random.default_rng(5).uniform(MARGIN, 18e-3, (CORNERS, 2))
    far = np.stack(np.meshgrid([0.0, 0.2], [0.0, 0.2]), axis=-1).reshape(-1, 2)
    return np.abs(np.resize(far, (CORNERS, 2)) - inside)


def error(world: World, sensor: Sensor, place: np.ndarray, seed: int) -> float:
    """Distance of the strongest contact (m), negative where none was found: that of the middle."""
    world.press(place, seed)
    state, percept = sensor.step(sensor.start(), world.scan)
    for _ in range(1, max(TOTAL // sensor.drive.injections, 1) if sensor.drive.adjustable else 1):
        state, percept = sensor.step(state, world.scan)
    if not percept.detections:
        return -float(np.linalg.norm(place - 0.1))
    return float(np.linalg.norm(np.subtract(percept.detections[0].position, place)))


def interval(errors: np.ndarray) -> list[float]:
    """95 % of the mean of errors (n_seeds, n_places), drawn anew over seeds and places."""
    random, means = np.random.default_rng(0), []
    for _ in range(2000):
        seeds, places = (random.integers(0, n, n) for n in errors.shape)
        means.append(errors[np.ix_(seeds, places)].mean())
    return [float(value) for value in np.quantile(means, [0.025, 0.975])]


def compare(kind: str, decibels: float, seeds: int, places: int) -> list[dict[str, Any]]:
    """A row for each drive and reader in one world."""
    world = World(kind, decibels)
    known = learned(world)
    where = np.random.default_rng(11).uniform(MARGIN, 0.2 - MARGIN, (places, 2))
    rows = []
    for drive in DRIVES:
        for reading in READINGS:
            row: dict[str, Any] = {"world": kind, "decibels": decibels, "drive": drive, "reader": reading}
            rows.append(row)
            try:
                sensor = build(mode(drive, reading), known)
            except OhmskinError as refusal:
                row["refused"] = str(refusal)
                continue
            frames = max(TOTAL // sensor.drive.injections, 1) if sensor.drive.adjustable else 1
            row["injections"] = frames * sensor.drive.injections
            for name, chosen in (("", where), ("corner_", corner_places())):
                signed = np.array([[error(world, sensor, place, seed) for place in chosen] for seed in range(seeds)])
                errors = np.abs(signed)
                row |= {
                    f"{name}mean": float(errors.mean()), f"{name}interval": interval(errors),
                    f"{name}median": float(np.median(errors)), f"{name}p95": float(np.quantile(errors, 0.95)),
                    f"{name}missed": float(((signed < 0) | (errors > BEYOND)).mean()), f"{name}trials": errors.size,
                }  # fmt: skip
            print(f"{kind} {decibels:g} dB {drive:10s} {reading:15s} mean {1e3 * row['mean']:6.2f} mm "
                  f"median {1e3 * row['median']:6.2f} corners {1e3 * row['corner_mean']:6.2f}", flush=True)  # fmt: skip
    return rows


PAGE = """# Every drive with every reader

What is measured (the drive) and how contacts are read from it (the reader) are chosen separately; this
table shows the errors of each pair. It is made by the sensors that a loop uses: `python -m benchmarks.sensors`. {about}

Mean error in millimetres (95 % interval over seeds and places), median, and the share of places missed; below it the
mean in the corners. *Driven*: the electrodes that carry the current are measured, too.

{tables}

## What it says

- **The reader has the largest effect.** With the same drive, contacts fitted to the data have errors {gain} times
  smaller (geometric mean over drives and worlds) than centroids of the image.
- **Driven electrodes carry the information on corners.** With the same drive and reader (fit), measuring them
  divides the error by {driven_open}, in the corners by {driven_corners} (geometric means).
- **Adaptive drives are compared with the best fixed set of 28 injections.** With the same reader (fit), the drive by
  position information has {p_over_best} of its error (in the order above), the paper's eq. (7) {o_over_best}; with
  driven electrodes {p_over_best_driven} and {o_over_best_driven}. {verdict}
- **The default mode is {default}**: of the modes that ship it has the least error, as a geometric mean over the three
  worlds. `tests/test_sensing.py` checks that with this table.
"""


def cell(row: dict[str, Any]) -> str:
    """One drive with one reader."""
    if "mean" not in row:
        return "refused"
    low, high = row["interval"]
    spread = f"({1e3 * low:.2f} to {1e3 * high:.2f}), {1e3 * row['median']:.2f}, {100 * row['missed']:.1f} %"
    return f"{1e3 * row['mean']:.2f} {spread}<br>corners {1e3 * row['corner_mean']:.2f}"


def table(rows: list[dict[str, Any]], kind: str, decibels: float) -> str:
    """One world as Markdown."""
    lines = [f"## {'Discs' if kind == 'discs' else 'Twin'}, {decibels:g} dB", ""]
    lines += ["| drive | injections | " + " | ".join(READINGS) + " |", "|---" * (2 + len(READINGS)) + "|"]
    for drive in DRIVES:
        own = [r for r in rows if (r["world"], r["decibels"], r["drive"]) == (kind, decibels, drive)]
        lines.append(f"| {drive} | {own[0].get('injections', '')} | {' | '.join(map(cell, own))} |")
    return "\n".join(lines)


def page(told: dict[str, Any]) -> str:
    """The documentation's page about a run."""
    rows = [row for row in told["rows"] if "mean" in row]
    worlds_of = list(dict.fromkeys((row["world"], row["decibels"]) for row in rows))
    errors = {(r["world"], r["decibels"], r["drive"], r["reader"]): (r["mean"], r["corner_mean"]) for r in rows}

    def over_best(drive: str, reading: str) -> list[float]:
        return [errors[(*w, drive, reading)][0] / errors[(*w, "best, 28", reading)][0] for w in worlds_of]

    def gain(before: str, after: str, which: int = 0) -> str:
        cases = [(*w, d) for w in worlds_of for d in DRIVES if (*w, d, before) in errors and (*w, d, after) in errors]
        ratios = [errors[(*case, before)][which] / errors[(*case, after)][which] for case in cases]
        return f"{np.exp(np.mean(np.log(ratios))):.1f}"

    listed = {
        (drive, reading): ", ".join(f"{value:.2f}" for value in over_best(drive, reading))
        for drive in ("position", "eq7") for reading in ("fit", "fit, driven")
    }  # fmt: skip
    earned = max(over_best("position", "fit, driven")) < 1
    about = (
        f"One contact at rest at {told['settings']['places']} random places, 10 mm and more from the rim, and at "
        f"{CORNERS} places in the corners, 10 to 18 mm from both sides, {told['settings']['seeds']} seeds each; "
        "a frame has 28 injections where the drive allows it, drives of four a frame are given seven frames. Where "
        "nothing is found the error is that of the middle of the sheet; that, and one beyond 30 mm, count as missed."
    )
    return PAGE.format(
        about=about,
        tables="\n\n".join(table(told["rows"], *world) for world in worlds_of),
        gain=gain("centroid", "fit"),
        driven_open=gain("fit", "fit, driven"),
        driven_corners=gain("fit", "fit, driven", 1),
        p_over_best=listed["position", "fit"],
        o_over_best=listed["eq7", "fit"],
        p_over_best_driven=listed["position", "fit, driven"],
        o_over_best_driven=listed["eq7", "fit, driven"],
        verdict=f"Adaptive drive is {'' if earned else 'not '}better in every world.",
        default=default_mode(Skin.load("paper")),
    )


def main() -> None:
    """Compare, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--places", type=int, default=50)
    parser.add_argument("--worlds", nargs="+", default=["discs:40", "discs:50", "pressed:50"])
    parser.add_argument("--output", type=Path, default=Path("docs/modes.json"))
    parser.add_argument("--page", type=Path, default=Path("docs/modes.md"))
    parser.add_argument("--again", action="store_true", help="write the page of the JSON that is there")
    chosen = parser.parse_args()
    if chosen.again:
        chosen.page.write_text(page(json.loads(chosen.output.read_text())))
        return
    worlds_chosen = [(kind, float(decibels)) for kind, decibels in (world.split(":") for world in chosen.worlds)]
    with ProcessPoolExecutor(2) as pool:
        asked = [pool.submit(compare, *world, chosen.seeds, chosen.places) for world in worlds_chosen]
        rows = [row for each in asked for row in each.result()]
    told = {"settings": {"seeds": chosen.seeds, "places": chosen.places}, "rows": rows}
    chosen.output.write_text(json.dumps(told, indent=1) + "\n")
    chosen.page.write_text(page(told))


if __name__ == "__main__":
    main()
