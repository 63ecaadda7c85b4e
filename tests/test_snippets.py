"""The lines of Python that the pages show run as they stand, with what the page takes for granted put beside them.

Whole scripts of the guide run in test_guides.py, those of README, publishing and robot in tests of their own.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import ohmskin
from recordings import Bench
from test_client import board, show, touched
from test_commands import looking
from test_view_browser import make_setup

import ohmskin as ohm
from ohmskin.forward import VoltageSource, drive_currents, drive_voltages, fit_background
from ohmskin.inverse import Kalman
from ohmskin.outlets.commands import CommandServer
from ohmskin.skin import Calibration

DOCS = Path(__file__).parents[1] / "docs"
SKIN = ohm.Skin.load("paper")
Names = dict[str, Any]


def blocks(page: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def sensed() -> Names:
    """A skin that was quiet and is pressed, and an estimator of its images."""
    device = ohm.VirtualSkin(SKIN, seed=1)
    pattern, model = ohm.adjacent(SKIN.electrodes.rings), SKIN.transfer_model()
    quiet = [device.scan(pattern) for _ in range(10)]
    device.press(1, 0.05, 0.12, radius=8e-3, pressure=20e3)
    frames = [device.scan(pattern) for _ in range(3)]
    baseline, known = ohm.Baseline.learn(quiet), ohm.SkinModel(SKIN, model, quiet)
    noise, difference = baseline.difference_noise, baseline.difference(frames[0])
    names = {"skin": SKIN, "device": device, "pattern": pattern, "model": model, "quiet": quiet, "frames": frames}
    names |= {"frame": frames[0], "baseline": baseline, "known": known, "noise": noise, "difference": difference}
    return names | {"ohm": ohm, "Kalman": Kalman, "estimator": ohm.GaussNewton(model, noise), "show": np.asarray}


def excited() -> Names:
    """A model with its pattern, driven at given currents and voltages."""
    electrodes = ohm.Electrodes.grid(SKIN.domain).with_discs(3e-3, 1e-5)
    model = ohm.TransferModel(ohm.mesh_domain(SKIN.domain, 5e-3, electrodes), electrodes, 1.83e-3)
    pattern = ohm.adjacent(electrodes.rings).with_driven
    volts = np.full((1, 16), np.nan)
    volts[0, :2] = 5.0, 0.0
    currents = np.zeros((1, 16))
    currents[0, :2] = 1e-3, -1e-3
    names = {"model": model, "pattern": pattern, "amperes": 1e-3, "currents": currents, "volts": volts}
    names |= {"VoltageSource": VoltageSource, "drive_voltages": drive_voltages, "drive_currents": drive_currents}
    return names | {"fit_background": fit_background, "resistance": 150.0, "voltages": model.voltages(pattern, 1e-3)}


def weighed() -> Names:
    """A loop of a calibrated skin that is pressed."""
    calibration = Calibration(strengths=(1e-4, 4e-4), forces=(1.0, 8.0), mode="16P")
    with ohm.Engine(lambda: ohm.connect("virtual:", skin=SKIN, seed=1), SKIN) as engine:
        engine.calibrate()
        engine.press(1, at=(0.05, 0.12), radius=8e-3, pressure=20e3)
        touches = list(islice(engine.touches(), 12))
        skin = replace(SKIN, calibration=calibration)
        return {"ohm": ohm, "skin": skin, "contact": touches[-1].contacts[0], "touches": touches, "known": engine.known}


def simulated() -> Names:
    assert ohmskin("dataset", "touches.zarr", "--count", "10", cwd=Path.cwd()).returncode == 0
    return {}


def shown() -> Names:
    return {"setup": make_setup()}


def tracked() -> Names:
    from ohmskin.sensing import drive_of

    device = ohm.VirtualSkin(SKIN, seed=1)
    (complete,) = drive_of(ohm.modes(SKIN)["16T"], SKIN).patterns
    quiet = [device.scan(piece) for _ in range(10) for piece in complete.split(24)]
    return {"ohm": ohm, "skin": SKIN, "device": device, "quiet": quiet}


def connected() -> Names:
    return {"device": Bench()}


def worn() -> Names:
    """What a body of examples/ felt."""
    Path("examples").symlink_to(DOCS.parent / "examples")
    contact = replace(touched().contacts[0], patch="chest", frame="torso")
    return {"felt": replace(touched(), contacts=(contact,))}


def nothing() -> Names:
    return {}


PAGES: dict[str, Callable[[], Names]] = {
    "guide/calibration.md": weighed,
    "guide/data-quality.md": sensed,
    "guide/datasets.md": simulated,
    "guide/drivers.md": connected,
    "guide/estimators.md": sensed,
    "guide/forward.md": excited,
    "guide/gestures.md": nothing,
    "guide/priors.md": sensed,
    "guide/regularisation.md": sensed,
    "guide/several-skins.md": worn,
    "guide/tracking.md": tracked,
    "live-page.md": shown,
    "reproduce.md": nothing,
    "safety.md": nothing,
    "tutorials/newcomer.md": nothing,
    "tutorials/robot.md": nothing,
}
ENDLESS = {
    "while True:": "for _ in range(2):",
    "while (felt := client.wait(1.0)) is not None:": "for felt in [client.wait(1.0)]:",
    "in engine.touches():": "in islice(engine.touches(), 12):",
    "seeds=20": "seeds=1",
    "port=8000": "port=0",
}
SCRIPTS = [path.read_text(encoding="utf-8") for path in DOCS.rglob("*.py")] + blocks(DOCS.parent / "README.md")


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OHMSKIN_BOARDS", str(tmp_path / "boards"))


@pytest.mark.parametrize("page", PAGES)
def test_the_python_of_a_page_runs_as_it_stands(page: str) -> None:
    shorter = [block for block in blocks(DOCS / page) if block not in SCRIPTS]
    assert shorter
    names = PAGES[page]() | {"islice": islice}
    with board() as writer:
        show(writer, touched())
        for block in shorter:
            for endless, short in ENDLESS.items():
                block = block.replace(endless, short)
            exec(compile(block, page, "exec"), names)


def test_commands_of_a_program_are_done() -> None:
    done: list[str] = []
    tare = partial(done.append, "tare")
    with CommandServer("skin", {"tare": tare, "set_mode": done.append}) as server, looking(server):
        exec(blocks(DOCS / "guide" / "publishing.md")[-1])
    assert done == ["tare", "16T"]


def test_a_recording_of_others_is_read(uef_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(uef_folder)
    exec(blocks(DOCS / "guide" / "import.md")[0], {"ohm": ohm})


def test_no_python_of_a_page_is_left_out() -> None:
    """Those named here run elsewhere: test_client.py, test_robot_sensor.py and above."""
    elsewhere = {"guide/publishing.md", "guide/robot.md", "guide/import.md"}
    made = {"_build", "gallery", "api"}
    pages = [page for page in DOCS.rglob("*.md") if not made & {*page.relative_to(DOCS).parts}]
    having = {str(page.relative_to(DOCS)) for page in pages if set(blocks(page)) - set(SCRIPTS)}
    assert having == {*PAGES} | elsewhere
