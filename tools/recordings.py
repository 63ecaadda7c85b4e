"""Make the recordings that ship with ohmskin: python tools/recordings.py. A finger wanders over the virtual skin."""

import time
from pathlib import Path

import numpy as np

import ohmskin as ohm
from ohmskin.device.demo import demo_finger
from ohmskin.recording import Recorder
from ohmskin.sensing import drive_of, modes

FOLDER = Path(__file__).parents[1] / "src" / "ohmskin" / "recording" / "examples"
EVERY, CYCLES = 0.1, 40  # s from cycle to cycle of the session, and how many
MODE, QUIET, PRESSED = "16I", 10, 20  # of the table: what is driven, its quiet frames and its others
SKIN = ohm.Skin.load("paper")


def session(path: Path) -> None:
    """Everything that the loop records but images."""
    with (
        Recorder(path, SKIN, images=0.0) as recorder,
        ohm.Engine(lambda: recorder.tee(ohm.connect("virtual:", skin=SKIN, seed=1)), SKIN) as engine,
    ):
        recorder.watch(engine)
        engine.calibrate()
        for k in range(CYCLES):
            due = time.monotonic() + EVERY
            engine.press(1, *demo_finger(SKIN.domain, k * EVERY))
            if (touch := engine.step()) is not None:
                recorder.publish(touch)
            time.sleep(max(0.0, due - time.monotonic()))


def table(path: Path) -> None:
    """Voltages as other instruments write them: a row per measurement, a column per frame."""
    virtual = ohm.VirtualSkin(SKIN, 1)
    pattern = drive_of(modes(SKIN)[MODE], SKIN).next((), 0)
    columns, amperes = {}, np.empty(0)
    for k in range(QUIET + PRESSED):
        if k >= QUIET:
            virtual.press(1, *(place := demo_finger(SKIN.domain, (k - QUIET) * 2 * EVERY))[0], *place[1:])
        frame = virtual.scan(pattern)
        amperes = amperes if k else frame.measurement_currents
        name = f"quiet {k + 1}" if k < QUIET else f"pressed {k + 1 - QUIET}"
        columns[name] = frame.voltages * amperes / frame.measurement_currents  # a table has one current for a row
    rows = np.column_stack([pattern.quadruples, amperes, *columns.values()])
    lines = ["# skin = paper", ", ".join(["source", "sink", "plus", "minus", "current", *columns])]
    lines += [", ".join([f"{int(e)}" for e in row[:4]] + [f"{value:.5g}" for value in row[4:]]) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, make in (("touch.mcap", session), ("touch.csv", table)):
        (FOLDER / name).unlink(missing_ok=True)
        make(FOLDER / name)
        print(FOLDER / name, (FOLDER / name).stat().st_size)
