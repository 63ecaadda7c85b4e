"""The robot demonstration: MuJoCo's truth, the real loop's senses, and an arm that yields."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from command_line import ohmskin
from matplotlib.figure import Figure
from matplotlib.image import imread

from ohmskin.body import Body
from ohmskin.errors import ModelError
from ohmskin.robot import Demonstration, Encounter, RobotSimulation, SelfTouchTrial, arm, engines, summary
from ohmskin.robot.demonstration import Moment, Sensed
from ohmskin.robot.scene import FINGER
from ohmskin.robot.simulation import above
from ohmskin.robot.video import SkinMap, snapshot
from ohmskin.skin import Calibration, Skin

SKIN = Skin.load("paper")
HUMANOID = Path(__file__).parents[1] / "examples" / "humanoid" / "body.toml"


def poke_arm(strategy: str = "yield", pokes: int = 3, skin: Skin = SKIN) -> list[Encounter]:
    body = arm(skin)
    with engines(body, seed=2, mode="16O") as loops:
        return list(Demonstration(body, loops, seed=4, strategy=strategy).pokes(pokes))


@pytest.fixture(scope="module")
def yielded() -> list[Encounter]:
    return poke_arm()


def test_pokes_are_felt_where_they_are(yielded: list[Encounter]) -> None:
    for encounter in yielded:
        assert np.isfinite(encounter.reaction)
        assert (encounter.felt_on, encounter.self_touches) == ("forearm", 0)
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
    stubborn = poke_arm("stiff")
    for soft, hard in zip(yielded, stubborn, strict=True):
        assert np.hypot(*np.subtract(soft.position, hard.position)) < 5e-3  # the same pokes
        assert soft.peak_force < 2 / 3 * hard.peak_force  # of a hand that pushes with some 20 N at most


def test_same_seed_same_run(yielded: list[Encounter]) -> None:
    assert poke_arm(pokes=1) == yielded[:1]


@pytest.mark.parametrize("aim", [(0.03, 0.05), (0.1, 0.17)])
def test_place_and_force_are_mujocos(aim: tuple[float, float]) -> None:
    """Held against the force that keeps the arm in its pose: the joints' torques are the Jacobian's transpose times
    it."""
    simulation = RobotSimulation(arm(SKIN))
    simulation.place_hand(above(simulation, 0, np.array(aim), 1e-3), simulation.surface(0, np.array(aim))[1])
    simulation.advance(2.0, above(simulation, 0, np.array(aim), -3e-3))
    (push,) = simulation.pushes()
    assert push.place == pytest.approx(aim, abs=2e-3)
    assert (push.by, push.patch) == ("", 0)
    assert push.force > 1.0
    jacobian = np.zeros((3, 3))
    mujoco.mj_jac(simulation.model, simulation.data, jacobian, None, push.point, simulation.model.body("forearm").id)
    torques = simulation.data.qfrc_constraint + simulation.data.qfrc_applied
    held = np.linalg.solve(jacobian.T, torques)  # the force (N) on the skin
    assert push.force == pytest.approx(-held @ simulation.surface(0, push.place)[1], rel=0.05)
    assert push.radius < FINGER


@pytest.mark.parametrize("deep", [1e-3, 3e-3])
def test_foam_bears_the_same_force_wherever_it_is(deep: float) -> None:
    """MuJoCo's own contacts bear a finger ten times better at the waist, where the torso gives way least."""
    body = Body.load(HUMANOID)
    simulation, forces = RobotSimulation(body), list[float]()
    for patch in range(len(body.patches)):
        place = np.mean(np.reshape(body.patches[patch].skin.domain.bounds, (2, 2)), axis=0)
        simulation.data.qpos[:], simulation.data.qvel[:] = simulation.target, 0.0
        mujoco.mj_forward(simulation.model, simulation.data)
        simulation.place_hand(above(simulation, patch, place, 1e-3), simulation.surface(patch, place)[1])
        for height in np.arange(1e-3, -deep, -0.08e-3):  # 80 mm/s
            simulation.advance(1e-3, above(simulation, patch, place, height))
        (push,) = simulation.pushes()
        forces.append(push.force / push.radius**4)
    assert max(forces) < 1.3 * min(forces), forces


def test_yielding_moves_the_touched_place_inwards() -> None:
    simulation, place = RobotSimulation(arm(SKIN)), np.array([0.15, 0.05])
    before, normal = simulation.surface(0, place)
    simulation.data.qpos[:] += 2e-3 * simulation.inward_step(0, place)
    mujoco.mj_forward(simulation.model, simulation.data)
    moved = simulation.surface(0, place)[0] - before
    assert moved @ normal == pytest.approx(-2e-3, rel=0.05)


def test_places_go_to_the_world_and_back_and_kinematics_agree() -> None:
    """On curved skins, too, while the robot moves: MuJoCo puts links where our kinematics do."""
    body = Body.load(HUMANOID)
    simulation = RobotSimulation(body)
    simulation.target = simulation.rest(2.0)
    simulation.advance(0.5, np.array([0.0, 0.0, 9.0]))
    assert simulation.pushes() == ()
    robot = simulation.posed()
    for number, placed in enumerate(body.patches):
        place = np.mean(np.reshape(placed.skin.domain.bounds, (2, 2)), axis=0) + np.array([0.01, 0.02])
        point, normal = simulation.surface(number, place)
        again, away = simulation.place(number, point)
        assert again == pytest.approx(place, abs=1e-6)
        assert away == pytest.approx(0, abs=1e-9)
        local = placed.patch.place(*placed.skin.chart.points([place])[0])
        assert robot.links[placed.patch.frame] @ [*local, 1] == pytest.approx([*point, 1], abs=1e-9)
        assert np.linalg.norm(normal) == pytest.approx(1)


def test_joints_that_mimic_others_move_with_them(tmp_path: Path) -> None:
    copytree(HUMANOID.parent, tmp_path / "body")
    file, robot = tmp_path / "body" / HUMANOID.name, tmp_path / "body" / "robot.urdf"
    file.write_text(re.sub(r"(?m)^left_elbow.*$", "", file.read_text()))
    elbow = '<joint name="left_elbow" type="revolute">'
    mimic = '<mimic joint="left_shoulder_pitch" multiplier="1.5" offset="-0.5"/>'
    assert elbow in robot.read_text()
    robot.write_text(robot.read_text().replace(elbow, elbow + mimic))
    simulation = RobotSimulation(Body.load(file))
    source, tied = (simulation.model.joint(name).qposadr[0] for name in ("left_shoulder_pitch", "left_elbow"))
    aimed = simulation.data.qpos.copy()
    assert aimed[tied] == pytest.approx(1.5 * aimed[source] - 0.5)
    aimed[source] -= 0.3
    simulation.aim(aimed)
    simulation.advance(2.0, np.array([0.0, 0.0, 9.0]))
    reached = simulation.data.qpos
    assert reached[source] == pytest.approx(aimed[source], abs=0.02)
    assert reached[tied] == pytest.approx(1.5 * reached[source] - 0.5, abs=2e-3)
    for name, pose in simulation.posed().links.items():
        assert simulation.data.body(name).xpos == pytest.approx(pose[:3, 3], abs=2e-3)
    number = next(k for k, placed in enumerate(simulation.body.patches) if placed.patch.frame == "left_forearm")
    place = np.mean(np.reshape(simulation.body.patches[number].skin.domain.bounds, (2, 2)), axis=0)
    before, normal = simulation.surface(number, place)
    step = 2e-3 * simulation.inward_step(number, place)
    assert step[tied] == pytest.approx(1.5 * step[source])
    simulation.stand(simulation.data.qpos + step)
    assert (simulation.surface(number, place)[0] - before) @ normal == pytest.approx(-2e-3, rel=0.05)


def test_a_robot_in_curved_skins_tells_pokes_from_its_self_touches() -> None:
    """Two skins of eight, to save time; forces as calibrated, a finger's from 3 to 20 N, within 35 % in the median.

    A poke counts as the robot's own touch in the few frames in which an arm passes as near to it as one that touches.
    """
    body = Body.load(HUMANOID)
    body = replace(body, patches=tuple(one for one in body.patches if one.patch.name in ("chest", "left_forearm")))
    with engines(body, seed=5) as loops:
        demonstration = Demonstration(body, loops, seed=3)
        pokes = list(demonstration.pokes(4))
        own = list(demonstration.self_touches(1))
        assert demonstration.free(1.0) == 0
    for poke in pokes:
        assert poke.felt_on == poke.link
        assert poke.invented == 0
        assert np.median(poke.errors) < 6e-3
        assert poke.peak_force < 22
    assert sum(poke.self_touches for poke in pokes) <= 0.05 * sum(len(poke.errors) for poke in pokes)
    figures: Any = summary(pokes, own)
    assert figures["force_error"]["median"] < 0.35
    assert figures["on_the_right_link"] == 4
    assert len({poke.patch for poke in pokes}) == 2
    assert figures["self_touches_felt"] == figures["self_touches_recognised"] == 1


def test_pads_press_several_skins_at_once_and_each_is_felt() -> None:
    """Two skins of eight, to save time: MuJoCo's forces are the truth, each skin's and their sum."""
    body = Body.load(HUMANOID)
    body = replace(body, patches=tuple(one for one in body.patches if one.patch.name in ("chest", "right_upper_arm")))
    moments = []
    with engines(body, seed=6) as loops:
        (hug,) = Demonstration(body, loops, seed=1).hugs(1, moments.append)
    assert set(hug.patches) == set(hug.felt) == {"chest", "right_upper_arm"}
    assert hug.invented == 0
    assert 0.03 < hug.reaction < 0.1
    assert np.median(hug.errors) < 6e-3
    assert max(len({push.patch for push in moment.pushes}) for moment in moments) == 2
    assert {push.hand for moment in moments for push in moment.pushes} == {1, 2}
    figures: Any = summary([], hugs=[hug])
    assert (figures["hugs"], figures["hugged_skins"], figures["hugged_skins_felt"]) == (1, 2, 2)
    assert figures["hug_force_error"]["median"] < 0.35
    assert figures["hug_total_force_error"]["median"] < 0.35
    true, _ = np.transpose(hug.totals)
    assert true.max() == pytest.approx(max(sum(p.force for p in m.pushes) for m in moments), rel=0.3)
    assert moments[-1].pushes == ()  # they let go


def test_summary_counts_what_was_not_felt() -> None:
    felt = Encounter("skin", "forearm", (0.1, 0.1), "forearm", 0.02, 5.0, (1e-3, 3e-3), ((2.0, 3.0),), 1, 2)
    missed = Encounter("skin", "forearm", (0.1, 0.1), "", np.nan, 50.0, ())
    wrong = replace(felt, felt_on="upper")
    figures = summary(
        [felt, missed, wrong], [SelfTouchTrial(("skin",), 5.0, 4, 3), SelfTouchTrial(("skin",), 5.0, 4, 1)]
    )
    told = {name: figures[name] for name in ("felt", "on_the_right_link", "invented", "taken_for_self_touch")}
    assert told == {"felt": 2, "on_the_right_link": 1, "invented": 2, "taken_for_self_touch": 4}
    assert [figures[f"self_touch{name}"] for name in ("es", "es_felt", "es_recognised", "_frames")] == [2, 2, 1, 8]
    figures = summary([felt, missed])
    assert figures["force_error"] == {"median": 0.5, "p95": 0.5, "worst": 0.5}
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
    film: Any = SimpleNamespace(draw=lambda _: np.zeros((4, 8, 3), np.uint8), faces=lambda _: 1.0)
    moment: Any = SimpleNamespace(
        sensed=[SimpleNamespace(push=SimpleNamespace(force=1.0), contact=SimpleNamespace(normal=()))]
    )
    with snapshot(tmp_path / "arm.picture", film) as show:
        show(moment)
    assert (tmp_path / "arm.picture").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ModelError, match="cannot write"), snapshot(tmp_path, film) as show:
        show(moment)


def test_the_brightest_place_of_the_picture_is_at_the_contact() -> None:
    body, away = arm(SKIN), list[float]()
    drawn = SkinMap(body.patches[0], Figure().add_subplot(), alone=True)
    places = np.stack(np.meshgrid(drawn.raster.x, drawn.raster.y), axis=-1)[drawn.raster.inside]

    def show(moment: Moment) -> None:
        if moment.sensed and moment.sensed[0].push is not None:
            drawn.draw(0, moment)
            away.append(float(np.linalg.norm(places[drawn.values.argmax()] - moment.sensed[0].push.place)))

    with engines(body, seed=2, mode="16O") as loops:
        assert len(list(Demonstration(body, loops, seed=4).pokes(1, show))) == 1
    assert len(away) > 20
    assert np.median(away) < 12e-3  # as `errors`, of which it is the image


def test_what_cannot_be_worn_is_refused() -> None:
    with pytest.raises(ModelError, match="rectangular skin, not a disc"):
        arm(Skin.load("tank"))
    with pytest.raises(ModelError, match="names no URDF file"):
        RobotSimulation(replace(arm(SKIN), robot=None))


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


def test_physics_needs_no_graphics_library_and_a_picture_names_the_package(tmp_path: Path) -> None:
    code = "import numpy as np, ohmskin; from ohmskin.robot import *; from ohmskin.robot.simulation import above\n"
    code += "worn = RobotSimulation(arm(ohmskin.Skin.load('paper'))); at = np.array([0.1, 0.1])\n"
    code += "worn.place_hand(above(worn, 0, at, 1e-3), worn.surface(0, at)[1])\n"
    code += "worn.advance(0.2, above(worn, 0, at, -3e-3))\n"
    code += "print(worn.pushes()[0].force)\nimport ohmskin.cli; ohmskin.cli.main()"
    done = without_graphics(code, "robot", "--picture", str(tmp_path / "arm.png"))
    assert float(done.stdout) > 1
    assert done.returncode == 2
    assert "apt-get install libegl1" in done.stderr
    assert "Traceback" not in done.stderr


def test_mujoco_that_was_imported_before_is_told_how_to_draw() -> None:
    """Without a display it draws with EGL or OSMesa only if it knew when it was imported."""
    code = "import mujoco; from ohmskin.robot.display import renderer\n"
    code += "renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 64, 64)"
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MUJOCO_GL")}
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, env=environment)
    assert "import ohmskin.robot before mujoco, or set MUJOCO_GL=" in done.stderr


def test_help_needs_no_mujoco() -> None:
    code = "import sys; sys.modules['mujoco'] = None; from command_line import ohmskin\n"
    code += "for words in (['--help'], ['--pokes', '1']): done = ohmskin('robot', *words); print(done.returncode, done)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parent)
    told, refused = done.stdout.splitlines()
    assert told.startswith("0 ")
    assert "--picture" in told
    assert refused.startswith("2 ")
    assert "pip install 'ohmskin[robot]'" in refused


def test_command_line_mistakes(tmp_path: Path) -> None:
    for arguments in (
        ["--pokes", "0"],
        ["--pokes", "0", "--hugs", "1", "--max-force", "20"],
        ["--seed", "-1"],
        ["--picture", str(tmp_path / "no" / "arm.png")],
        ["--skin", "tank"],
        ["--skin", "paper", "--body", str(HUMANOID)],
        ["--free", "-1"],
    ):
        done = ohmskin("robot", *arguments)
        assert done.returncode == 2
        assert done.stderr.strip().splitlines()[-1].startswith("ohmskin:")
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--strategy", "bite", "no reaction strategy 'bite'; choose from yield, "),
        ("--strategy", "follow", "strategy 'follow' needs newtons"),
        *((f"--max-{of}", value, f"--max-{of} is ") for of in ("force", "reaction") for value in ("nan", "-1", "0")),
    ],
)
def test_limits_and_strategies_that_are_none_are_refused_at_once(
    option: str, value: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ohmskin.robot.engines", lambda *_: pytest.fail("calibrated"))
    done = ohmskin("robot", option, value)
    assert done.returncode == 2
    assert done.stderr.startswith(f"ohmskin: {says}")
    assert "choose" in done.stderr


def test_a_robot_that_cannot_touch_itself_is_told_before_it_is_poked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.robot.engines", lambda *_: pytest.fail("calibrated"))
    monkeypatch.setattr("ohmskin.robot.reach._TRIES", 1)
    done = ohmskin("robot", "--self-touches", "1")
    assert done.returncode == 2
    assert "leave out --self-touches" in done.stderr


def test_each_strategy_reacts_as_described() -> None:
    """One cycle's command, of a touch of 6 N: where the joints go, and whether the robot's own movement goes on."""
    skin, layer = Skin.load("paper"), Skin.load("paper").contact_layer
    known = Calibration(layer_conductance=layer.conductance, layer_exponent=layer.exponent)
    body = arm(replace(skin, calibration=known))
    device: Any = SimpleNamespace(device=SimpleNamespace(capabilities=SimpleNamespace(virtual=True)))
    place = (0.1, 0.1)

    def commanded(strategy: str, force: float | None, cycles: int = 20) -> tuple[float, float]:
        """How far (m) the touched place is to go inwards, and for how long (s) all else stood still."""
        demonstration = Demonstration(body, [device], strategy=strategy)
        demonstration._elapsed = 5e-3
        contact: Any = SimpleNamespace(self_touch=False, force=force)
        for _ in range(cycles):
            demonstration._command([Sensed(0, place, contact, None)])
        inwards = demonstration._offset @ demonstration.simulation.inward_step(0, np.array(place))
        unit = demonstration.simulation.inward_step(0, np.array(place))
        return float(inwards / (unit @ unit)), demonstration._halted

    for strategy, force, metres, halted in (
        ("stiff", 6.0, 0.0, 0.0),
        ("stop", 6.0, 0.0, 0.1),
        ("guide", 6.0, 0.012, 0.1),
        ("guide", None, 0.010, 0.1),
        ("guide", 60.0, 0.025, 0.1),  # no quicker than 0.25 m/s
        ("follow", 6.0, 0.008, 0.1),
        ("follow", 2.0, 0.0, 0.1),
        ("follow", 0.5, -0.003, 0.1),
        ("follow", None, 0.0, 0.1),
    ):
        assert commanded(strategy, force) == pytest.approx((metres, halted), abs=1e-6)
    for strategy, force, metres, halted in (("yield", 6.0, 0.012, 0.0), ("retract", 1.0, 0.025, 0.1)):
        far, stood = commanded(strategy, force)
        assert 0.9 * metres < far < metres  # on its way back already
        assert stood == pytest.approx(halted)
    with pytest.raises(ModelError, match="choose from yield, stiff, stop"):
        Demonstration(body, [device], strategy="bite")
    with pytest.raises(ModelError, match="skin 'skin' does not have; calibrate it"):
        Demonstration(arm(skin), [device], strategy="follow")


def test_limits_that_are_exceeded_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    felt = Encounter("skin", "forearm", (0.1, 0.1), "forearm", 0.02, 5.0, (1e-3,))
    missed = replace(felt, reaction=np.nan, peak_force=21.0)
    monkeypatch.setattr("ohmskin.robot.engines", lambda *_: nullcontext(()))
    none = dict.fromkeys(("hugs", "self_touches"), lambda *_: [])
    still = SimpleNamespace(time=0.0)
    demonstration = SimpleNamespace(pokes=lambda *_: [felt, missed], free=lambda *_: 0, simulation=still, **none)
    monkeypatch.setattr("ohmskin.robot.Demonstration", lambda *_: demonstration)
    told = ohmskin("robot", "--max-force", "20", "--max-reaction", "0.05")
    assert told.returncode == 1
    assert "poke 2: 21.0 N exceeds the limit of 20 N" in told.stderr
    assert "poke 2: no reaction exceeds the limit of 0.05 s" in told.stderr
    assert "poke 1" not in told.stderr
    assert ohmskin("robot", "--max-force", "25").returncode == 0


def test_pokes_and_free_motion_say_how_far_they_are_in_a_pipe_too(monkeypatch: pytest.MonkeyPatch) -> None:
    felt = Encounter("skin", "forearm", (0.1, 0.1), "forearm", 0.02, 5.0, (1e-3,))

    def pokes(*_: Any) -> Iterator[Encounter]:
        yield felt
        time.sleep(2.2)
        yield felt

    def free(_: float, show: Any) -> int:
        show(SimpleNamespace(time=52.0))
        time.sleep(2.2)
        return 0

    none = dict.fromkeys(("hugs", "self_touches"), lambda *_: [])
    demonstration = SimpleNamespace(pokes=pokes, free=free, simulation=SimpleNamespace(time=10.0), **none)
    monkeypatch.setattr("ohmskin.robot.engines", lambda *_: nullcontext(()))
    monkeypatch.setattr("ohmskin.robot.Demonstration", lambda *_: demonstration)
    told = ohmskin("robot", "--pokes", "2", "--free", "600")
    assert "pokes: 1 of 2 done" in told.stderr
    assert "free motion: 42 of 600 s" in told.stderr
    demonstration.pokes = lambda *_: []
    told = ohmskin("robot", "--pokes", "0", "--free", "600")
    assert (told.returncode, told.stdout) == (0, "0 false contacts in 600 s of free motion\n")
