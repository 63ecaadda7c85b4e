"""What the drive gives and what the reader gives: every drive with every reader, at equal noise.

    python -m benchmarks.sensors [--seeds 4] [--places 50] [--worlds discs:40 ...] [--output docs/modes.json]

One contact at rest at random places of the paper's sheet, 10 mm and more from its rim. The sensors are those that a
loop uses, made by name (`ohmskin.sensing.build`) and calibrated on 40 quiet scans of each world of `ohmskin.evaluate`,
none of which is the estimator's own model: discs of raised conductivity (radius 10 mm, +50 %), and patches pressed on
the sheet (8 mm, 20 kPa). Noise is one level for all, in decibels below the largest voltage of the adjacent scan on the
rim. A frame has 28 injections; drives of four a frame are given seven frames. The error is that of the strongest
contact; where none is found, that of the middle of the sheet, and the place counts as missed, as it does beyond 30 mm.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ohmskin.errors import OhmskinError
from ohmskin.evaluate import worlds
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import READERS, Sensor, SkinModel, build, default_mode, drive_of
from ohmskin.skin import Mode, Skin

DRIVES = {  # name and injections a frame, 0 where there is no choice
    "rim": 0, "rings": 0, "opposite": 0, "best, 16": 16, "best, 28": 28,
    "eq7": 28, "local": 28, "position": 28, "rotating": 4, "tracking": 4,
}  # fmt: skip
TOTAL = 28  # injections from which a contact is told
QUIET = 40
BEYOND = 30e-3  # m, from where on an error is a miss
MARGIN = 10e-3


class World:
    """A sheet of `ohmskin.evaluate.worlds` that is scanned like a device, with white noise.

    Args:
        kind: One of `worlds.WORLDS`.
        decibels: Noise level.
    """

    def __init__(self, kind: str, decibels: float) -> None:
        self.kind, self.noise = kind, worlds.noise_volts(kind, decibels)
        skin = Skin.load("paper")
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


def mode(drive: str, reader: str) -> Mode:
    """A drive of the table with a reader."""
    return Mode(f"{drive}, {reader}", drive.split(",")[0], reader, injections=DRIVES[drive])


def learned(world: World) -> SkinModel:
    """What a calibration learns of a quiet world."""
    world.press(None, 1)
    patterns = {p: None for drive in DRIVES for p in drive_of(mode(drive, "centroid"), world.skin).patterns}
    quiet = [world.scan(pattern) for _ in range(QUIET) for pattern in patterns]
    return SkinModel(world.skin, world.skin.transfer_model(), quiet)


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
        for reader in READERS:
            try:
                sensor = build(mode(drive, reader), known)
            except OhmskinError as refusal:
                rows.append(
                    {"world": kind, "decibels": decibels, "drive": drive, "reader": reader, "refused": str(refusal)}
                )
                continue
            signed = np.array([[error(world, sensor, place, seed) for place in where] for seed in range(seeds)])
            errors = np.abs(signed)
            missed = (signed < 0) | (errors > BEYOND)
            injections = max(TOTAL // sensor.drive.injections, 1) * sensor.drive.injections
            rows.append(
                {
                    "world": kind, "decibels": decibels, "drive": drive, "reader": reader,
                    "injections": injections if sensor.drive.adjustable else sensor.drive.injections,
                    "mean": float(errors.mean()), "interval": interval(errors), "median": float(np.median(errors)),
                    "p95": float(np.quantile(errors, 0.95)), "missed": float(missed.mean()),
                    "trials": int(errors.size),
                }
            )  # fmt: skip
            print(f"{kind} {decibels:g} dB {drive:10s} {reader:9s} mean {1e3 * errors.mean():6.2f} mm "
                  f"median {1e3 * np.median(errors):6.2f} missed {missed.mean():.3f}", flush=True)  # fmt: skip
    return rows


PAGE = """# Every drive with every reader

What is measured (the drive) and how contacts are told from it (the reader) are chosen apart from each other; this
table says what each gives. It is made by the sensors that a loop uses: `python -m benchmarks.sensors`. {about}

Mean error in millimetres (95 % interval over seeds and places), median, and the share of places missed.

{tables}

## What it says

- **The reader gives most.** With the same drive, contacts fitted to the data are {gain} times closer (geometric mean
  over drives and worlds) than centroids of the image.
- **The best fixed set of 28 injections is the baseline of every adaptive claim.** With the same reader (fit), the drive
  by position information has {p_over_best} of its error (in the order above), the paper's eq. (7) {o_over_best}:
  {verdict}
- **The default mode is {default}**: of the modes that ship it has the least error, as a geometric mean over the three
  worlds. `tests/test_sensing.py` holds that against this table.
"""


def table(rows: list[dict[str, Any]], kind: str, decibels: float) -> str:
    """One world as Markdown."""
    lines = [f"### {'Discs' if kind == 'discs' else 'Twin'}, {decibels:g} dB", ""]
    lines += ["| drive | injections | " + " | ".join(READERS) + " |", "|---" * (2 + len(READERS)) + "|"]
    for drive in DRIVES:
        own = [r for r in rows if (r["world"], r["decibels"], r["drive"]) == (kind, decibels, drive)]
        cells = []
        for row in own:
            low, high = row.get("interval", (0, 0))
            cells.append(
                f"{1e3 * row['mean']:.2f} ({1e3 * low:.2f} to {1e3 * high:.2f}), {1e3 * row['median']:.2f}, "
                f"{100 * row['missed']:.1f} %" if "mean" in row else "refused"
            )  # fmt: skip
        lines.append(f"| {drive} | {own[0].get('injections', '')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def page(told: dict[str, Any]) -> str:
    """The documentation's page about a run."""
    rows = told["rows"]
    worlds_of = list(dict.fromkeys((row["world"], row["decibels"]) for row in rows))
    mean = {(r["world"], r["decibels"], r["drive"], r["reader"]): r["mean"] for r in rows if "mean" in r}

    def over(drive: str) -> list[float]:
        return [mean[(*w, drive, "fit")] / mean[(*w, "best, 28", "fit")] for w in worlds_of]

    ratios = [mean[(*w, d, "centroid")] / mean[(*w, d, "fit")] for w in worlds_of for d in DRIVES]
    position = over("position")
    earned = "adaptivity has earned its keep." if max(position) <= 0.8 else "adaptivity has yet to earn its keep."
    about = (
        f"One contact at rest at {told['settings']['places']} random places, 10 mm and more from the rim, "
        f"{told['settings']['seeds']} seeds each; a frame has 28 injections where the drive allows it, drives of "
        "four a frame are given seven frames. Where nothing is found the error is that of the middle of the sheet; "
        "that, and an error beyond 30 mm, count as missed."
    )
    return PAGE.format(
        about=about,
        tables="\n\n".join(table(rows, *world) for world in worlds_of),
        gain=f"{np.exp(np.mean(np.log(ratios))):.1f}",
        p_over_best=", ".join(f"{value:.2f}" for value in position),
        o_over_best=", ".join(f"{value:.2f}" for value in over("eq7")),
        verdict=earned,
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
    rows = []
    for world in chosen.worlds:
        kind, decibels = world.split(":")
        rows += compare(kind, float(decibels), chosen.seeds, chosen.places)
        settings = {"seeds": chosen.seeds, "places": chosen.places}
        told = {"settings": settings, "rows": rows}
        chosen.output.write_text(json.dumps(told, indent=1) + "\n")
        chosen.page.write_text(page(told))


if __name__ == "__main__":
    main()
