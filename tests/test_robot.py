"""The robot demonstration: MuJoCo's truth, the real loop's senses, and an arm that yields."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import ohmskin
from matplotlib.image import imread

from ohmskin import Engine, Skin, connect
from ohmskin.errors import ModelError
from ohmskin.robot import Arm, Demonstration, Encounter, summary
from ohmskin.robot.arm import FINGER, above
from ohmskin.robot.film import snapshot

SKIN = Skin.load("paper")


def poke_arm(yielding: bool = True, pokes: int = 3, skin: Skin = SKIN) -> list[Encounter]:
    with Engine(lambda: connect("virtual:", skin=skin, seed=2, realtime=False), skin, "16O") as engine:
        engine.calibrate()
        return list(Demonstration(engine, seed=4, yielding=yielding).pokes(pokes))


@pytest.fixture(scope="module")
def yielded() -> list[Encounter]:
    return poke_arm()


def test_pokes_are_felt_where_they_are(yielded: list[Encounter]) -> None:
    for encounter in yielded:
        assert np.isfinite(encounter.reaction)
        assert encounter.errors
        assert np.median(encounter.errors) < 12e-3
    corners = np.array([[0.02, 0.02], [0.18, 0.18]])
    places = np.array([e.position for e in yielded])
    assert ((places > corners[0] - 5e-3) & (places < corners[1] + 5e-3)).all()
    assert np.ptp(places, axis=0).min() > 0.03  # so that places in a mirror or at the middle would not pass


def test_reaction_is_at_least_the_frames_that_it_takes(yielded: list[Encounter]) -> None:
    """A contact is reported when it was seen three frames running; 28 injections take the device 28 x 120 us,
    computing 2 ms."""
    for encounter in yielded:
        assert 3 * (28 * 120e-6 + 2e-3) - 1e-9 < encounter.reaction < 0.1


def test_yielding_spares_the_arm_most_of_the_force(yielded: list[Encounter]) -> None:
    stubborn = poke_arm(yielding=False)
    for soft, hard in zip(yielded, stubborn, strict=True):
        assert np.hypot(*np.subtract(soft.position, hard.position)) < 5e-3  # the same pokes
        assert soft.peak_force < 0.5 * hard.peak_force


def test_same_seed_same_run(yielded: list[Encounter]) -> None:
    assert poke_arm(pokes=1) == yielded[:1]


@pytest.mark.parametrize("aim", [(0.03, 0.05), (0.1, 0.17)])
def test_place_and_force_are_mujocos(aim: tuple[float, float]) -> None:
    """Held against the force that keeps the arm in its pose: the joints' torques are the Jacobian's transpose times
    it."""
    arm = Arm(0.2, 0.2)
    finger = above(arm, np.array(aim), -3e-3)
    arm.advance(2.0, finger)
    poke = arm.poke()
    assert poke is not None
    assert poke.position == pytest.approx(aim, abs=2e-3)
    assert poke.force > 5.0
    jacobian = np.zeros((3, 3))
    place = arm.to_world(poke.position)
    mujoco.mj_jac(arm.model, arm.data, jacobian, None, place, arm.model.body("forearm").id)
    held = np.linalg.solve(jacobian.T, arm.data.qfrc_constraint)  # the force (N) on the skin, friction included
    assert poke.force == pytest.approx(-held @ arm.normal, rel=0.05)
    assert poke.radius < FINGER


def test_retreat_moves_the_touched_place_inwards() -> None:
    arm = Arm(0.2, 0.2)
    place = np.array([0.15, 0.05])
    before, normal = arm.to_world(place), arm.normal
    arm.retreat(place, speed=0.2, seconds=0.01)
    arm.data.qpos[:] = arm.target
    mujoco.mj_forward(arm.model, arm.data)
    moved = arm.to_world(place) - before
    assert moved @ normal == pytest.approx(-2e-3, rel=0.05)


def test_places_go_to_the_world_and_back() -> None:
    arm = Arm(0.2, 0.1)
    for place in ((0.0, 0.0), (0.2, 0.1), (0.05, 0.07)):
        assert arm.to_skin(arm.to_world(np.array(place))) == pytest.approx(place, abs=1e-12)
    assert arm.poke() is None


def test_summary_counts_what_was_not_felt() -> None:
    felt = Encounter((0.1, 0.1), 0.02, 1.0, 5.0, (1e-3, 3e-3))
    missed = Encounter((0.1, 0.1), np.nan, np.nan, 50.0, ())
    figures = summary([felt, missed])
    assert figures["felt"] == 1
    assert figures["frames_in_contact"] == 2
    assert figures["position_error"] == {
        "median": pytest.approx(2e-3),
        "p95": pytest.approx(2.9e-3),
        "worst": pytest.approx(3e-3),
    }
    assert figures["reaction_time"] == {"median": 0.02, "p95": 0.02, "worst": 0.02}
    assert figures["peak_force"]["worst"] == 50.0  # type: ignore[index]
    assert summary([missed])["reaction_time"] is None
    json.dumps(figures, allow_nan=False)


def test_a_snapshot_is_a_png_whatever_its_name_and_says_where_it_cannot_be_written(tmp_path: Path) -> None:
    from types import SimpleNamespace
    from typing import Any

    film: Any = SimpleNamespace(draw=lambda _: np.zeros((4, 8, 3), np.uint8))
    moment: Any = SimpleNamespace(poke=SimpleNamespace(force=1.0), touch=SimpleNamespace(contacts=[1]))
    with snapshot(tmp_path / "arm.picture", film) as show:
        show(moment)
    assert (tmp_path / "arm.picture").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ModelError, match="cannot write"), snapshot(tmp_path, film) as show:
        show(moment)


def test_round_skin_is_refused() -> None:
    with (
        Engine(lambda: connect("virtual:", skin=Skin.load("tank")), Skin.load("tank")) as engine,
        pytest.raises(ModelError, match="rectangular"),
    ):
        Demonstration(engine)


def test_skin_of_another_shape() -> None:
    oblong = replace(SKIN, sheet=replace(SKIN.sheet, width=0.24, height=0.16))
    for encounter in poke_arm(pokes=1, skin=oblong):
        assert np.median(encounter.errors) < 12e-3


def test_command_line_draws_and_films(tmp_path: Path) -> None:
    picture, video = tmp_path / "arm.png", tmp_path / "arm.mp4"
    arguments = ["robot", "--pokes", "1", "--mode", "16O", "--picture", str(picture), "--video", str(video), "--json"]
    done = subprocess.run([sys.executable, "-m", "ohmskin", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["felt"] == 1
    pixels = imread(picture)
    assert pixels.shape[:2] == (480, 960)
    arm, skin = pixels[:, :480, :3], pixels[:, 480:, :3]
    assert arm.std() > 0.1
    assert skin.std() > 0.1
    green = (arm[..., 1] > arm[..., 0] + 0.2) & (arm[..., 1] > arm[..., 2] + 0.1)
    assert green.sum() > 5, "the sensed place is marked on the arm"
    probe = [
        "ffprobe",
        "-v",
        "error",
        "-count_frames",
        "-show_entries",
        "stream=nb_read_frames,width",
        "-of",
        "csv=p=0",
        str(video),
    ]
    width, frames = subprocess.run(probe, capture_output=True, text=True, check=True).stdout.strip().split(",")
    assert int(width) == 960
    assert int(frames) > 30


BARE = """
import ctypes, sys
load = ctypes.CDLL.__init__
def bare(self, name, *rest, **named):
    if name and any(word in name for word in ("EGL", "OSMesa", "libGL")):
        raise OSError(name)
    load(self, name, *rest, **named)
ctypes.CDLL.__init__ = bare
"""


def without_graphics(code: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Runs code on a machine without EGL, OSMesa and a display."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MUJOCO_GL")}
    command = [sys.executable, "-c", BARE + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


def test_physics_needs_no_graphics_library() -> None:
    code = "import numpy as np; from ohmskin.robot.arm import Arm, above; arm = Arm(0.2, 0.2)\n"
    code += "arm.advance(0.2, above(arm, np.array([0.1, 0.1]), -3e-3)); print(arm.poke().force)"
    done = without_graphics(code)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 1


def test_a_picture_without_a_graphics_library_names_the_package(tmp_path: Path) -> None:
    done = without_graphics("import ohmskin.cli; ohmskin.cli.main()", "robot", "--picture", str(tmp_path / "arm.png"))
    assert done.returncode == 2
    assert "apt-get install libegl1" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_needs_no_mujoco() -> None:
    code = "import sys; sys.modules['mujoco'] = None; import ohmskin.cli; ohmskin.cli.main()"
    done = without_graphics(code, "robot", "--help")
    assert done.returncode == 0, done.stderr
    assert "--picture" in done.stdout
    done = without_graphics(code, "robot", "--pokes", "1")
    assert done.returncode == 2
    assert "pip install 'ohmskin[robot]'" in done.stderr


def test_command_line_mistakes(tmp_path: Path) -> None:
    for arguments in (
        ["--pokes", "0"],
        ["--seed", "-1"],
        ["--picture", str(tmp_path / "no" / "arm.png")],
        ["--skin", "tank"],
    ):
        done = ohmskin("robot", *arguments)
        assert done.returncode == 2
        assert done.stderr.strip().splitlines()[-1].startswith("ohmskin:")
        assert "Traceback" not in done.stderr
