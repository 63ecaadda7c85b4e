"""A skin on a geom of any MuJoCo model: what it gives, how it is batched, and what Gymnasium makes of it."""

import re
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from ohmskin.client.contacts import Patch
from ohmskin.client.points import point_names, points
from ohmskin.errors import ModelError
from ohmskin.robot.batch import BatchSkin
from ohmskin.robot.sensor import SkinSensor
from ohmskin.skin import Fault, Press, Skin, VirtualSkin

SCENE = """
<mujoco>
  <default><geom solref="0.02 1" solimp="0.1 0.9 0.006 0.5 2"/></default>
  <worldbody>
    <geom name="table" type="box" size=".12 .12 .01" pos="0 0 0.3" euler="0 0 90"/>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <geom name="post" type="cylinder" size=".045 .1" pos="0.6 0 0.5"/>
    <body name="ball" pos="0.03 -0.02 0.33"><freejoint/><geom type="sphere" size="0.02" mass="0.5"/></body>
    <body name="rod" pos="0.675 0 0.5"><joint type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.025" mass="0.5"/></body>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin.load("paper")


@pytest.fixture(scope="module")
def resting() -> tuple[Any, Any]:
    """A ball of half a kilogram that lies on the table."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    return model, data


@pytest.fixture(scope="module")
def sensor(resting: tuple[Any, Any], skin: Skin) -> Iterator[SkinSensor]:
    with SkinSensor(resting[0], "table", skin, mode="16O", seed=1) as sensor:
        yield sensor


def test_what_lies_on_the_geom_is_felt_where_it_lies_with_its_weight(
    sensor: SkinSensor, resting: tuple[Any, Any]
) -> None:
    model, data = resting
    (push,) = sensor.pushes(data)
    assert push.by == "ball"
    assert push.force == pytest.approx(0.5 * 9.81, rel=1e-3)
    (press,) = sensor.presses(data)
    assert press.force(sensor.skin.contact_layer.foam_spread) == pytest.approx(push.force)
    assert np.abs(sensor.voltages([()])[0] - sensor.quiet).max() < 8 * sensor.skin.converter.noise
    assert np.abs(sensor.voltages([[press]])[0] - sensor.quiet).max() > 20 * sensor.skin.converter.noise
    empty = mujoco.MjData(model)
    mujoco.mj_forward(model, empty)
    assert sensor(empty).contacts == ()
    for _ in range(5):
        touch = sensor(data)
    (contact,) = touch.contacts
    place = sensor.patch.place(*contact.position)  # in the frame of the table, which is turned by a right angle
    there = data.geom("table").xmat.reshape(3, 3) @ place + data.geom("table").xpos
    assert np.linalg.norm(there[:2] - data.body("ball").xpos[:2]) < 5e-3
    assert touch.percept.image.values.max() > touch.percept.image.values.std()


def test_curved_skins_and_planes_are_felt_too(resting: tuple[Any, Any]) -> None:
    model = resting[0]
    data = mujoco.MjData(model)
    data.qvel[-1] = -0.2  # the ball on the slide moves towards the post
    with SkinSensor(model, "post", "sleeve", seed=1) as sensor:
        for _ in range(200):
            mujoco.mj_step(model, data)
            if pushes := sensor.pushes(data):
                break
        (push,) = pushes
        point = np.array(sensor.patch.place(*sensor.skin.chart.points([push.place])[0]))
        assert np.linalg.norm(data.geom("post").xpos + point - push.point) < 10e-3
        assert point[0] == pytest.approx(0.045, abs=1e-3)
    with SkinSensor(model, "floor", "paper") as flat:
        assert flat.patch.place(0.1, 0.1) == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("geom", "skin", "patch", "why"),
    [
        ("tabel", "paper", None, "no geom 'tabel'; it has 'table', 'floor', 'post'"),
        ("table", "sleeve", None, "give `patch`"),
        ("table", "paper", Patch("x", "table", (0.1, 0.0, 0.01)), "does not lie on geom 'table'.*mm"),
        ("post", "paper", Patch("x", "post"), "does not lie on geom 'post'"),
    ],
)
def test_a_skin_that_does_not_fit_is_told(resting: tuple[Any, Any], geom: str, skin: str, patch: Any, why: str) -> None:
    with pytest.raises(ModelError, match=why):
        SkinSensor(resting[0], geom, skin, patch)


SCENES = [
    [],
    [Press((0.05, 0.12), 8e-3, 20e3)],
    [Press((0.002, 0.003), 9e-3, 60e3), Press((0.15, 0.15), 4e-3, 5e3)],
    [Press((0.101, 0.1), 6e-3, 30e3), Press((0.108, 0.1), 6e-3, 10e3)],  # on one patch
]


def test_many_at_once_are_what_they_are_one_by_one(skin: Skin) -> None:
    quick, slow = BatchSkin(skin), VirtualSkin(skin, contacts=4)
    found = quick.sheet.many(SCENES)
    for presses, resistance in zip(SCENES, found, strict=True):
        expected = slow.sheet.transfer_resistance(presses)
        scale = np.abs(expected - slow.sheet.untouched).max() or 1.0
        assert np.abs(resistance - expected).max() < 1e-9 * scale


def test_noise_and_faults_are_those_of_the_virtual_skin(skin: Skin, sensor: SkinSensor) -> None:
    faults = [Fault.parse("open 3"), Fault.parse("high 5 20")]
    quick, slow = BatchSkin(skin, 7, faults), VirtualSkin(skin, 7, faults, 4)
    for presses, frame in zip(SCENES, quick.scans(SCENES, sensor.pattern), strict=True):
        for number, press in enumerate(presses):
            slow.press(number, *press.position, press.radius, press.pressure)
        expected = slow.scan(sensor.pattern)
        for number, press in enumerate(presses):
            slow.press(number, *press.position, press.radius, 0.0)
        assert frame.voltages == pytest.approx(expected.voltages, abs=2 * skin.converter.full_scale / 2**15)
        assert (frame.flags, frame.sequence) == (expected.flags, expected.sequence)


def test_a_batch_is_quicker_than_one_by_one(skin: Skin, sensor: SkinSensor) -> None:
    random = np.random.default_rng(0)
    scenes = [[Press((float(x), float(y)), 6e-3, 2e4)] for x, y in random.uniform(0.05, 0.09, (60, 2))]
    slow = VirtualSkin(skin, contacts=4)

    def one_by_one() -> None:
        for (press,) in scenes:
            slow.press(0, *press.position, press.radius, press.pressure)
            slow.scan(sensor.pattern)

    def best(call: Any) -> float:
        times = []
        for _ in range(5):
            started = time.process_time()
            call()
            times.append(time.process_time() - started)
        return min(times[1:])

    assert best(lambda: sensor.voltages(scenes)) < 0.6 * best(one_by_one)


def test_contacts_are_a_vector_of_fixed_length(sensor: SkinSensor, resting: tuple[Any, Any]) -> None:
    contacts = [*map(sensor.patch.contact, sensor(resting[1]).contacts)]
    told = dict(zip(point_names(2), points(contacts, 2), strict=True))
    assert (told["contact_0.present"], told["contact_1.present"]) == (1.0, 0.0)
    assert (told["contact_0.x"], told["contact_0.force"]) == (contacts[0].position[0], 0.0)  # not calibrated: no force
    assert len(points(contacts * 5, 2)) == 12


def test_an_episode_is_the_same_every_time_with_the_same_seed(resting: tuple[Any, Any], skin: Skin) -> None:
    """Also the first, in which the loop is calibrated, and whatever seed that had."""

    def episode(sensor: SkinSensor, seed: int) -> list[Any]:
        sensor.reset(seed)
        changes = sensor.voltages([()])  # which takes noise, too
        return [changes, *(sensor(resting[1]).percept.image.values for _ in range(5))]

    with (
        SkinSensor(resting[0], "table", skin, mode="16O", seed=1) as one,
        SkinSensor(resting[0], "table", skin, mode="16O", seed=1) as other,
    ):
        first = episode(one, 3)
        episode(other, 99)
        for again in (episode(one, 3), episode(other, 3)):
            assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(first, again, strict=True))
        assert not np.array_equal(first[0], episode(one, 4)[0])


def test_gymnasium_takes_it_for_an_environment(resting: tuple[Any, Any], sensor: SkinSensor) -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="needs Gymnasium: pip install 'ohmskin[gym]'")
    from gymnasium.utils.env_checker import check_env

    from ohmskin.robot.gym import SkinObservation

    class Drop(gymnasium.Env):  # type: ignore[misc, name-defined]
        """Moves the ball about; nothing more."""

        def __init__(self) -> None:
            self.model, self.data = resting[0], mujoco.MjData(resting[0])
            self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
            self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)

        def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
            super().reset(seed=seed)
            mujoco.mj_resetData(self.model, self.data)
            self.data.qpos[:2] = self.np_random.uniform(-0.05, 0.05, 2)
            mujoco.mj_forward(self.model, self.data)
            return self.data.qpos[:3].copy(), {}

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            self.data.qfrc_applied[:2] = action
            mujoco.mj_step(self.model, self.data, 40)
            return self.data.qpos[:3].copy(), 0.0, False, False, {}

    for kind, size in (("voltages", (108,)), ("image", (32, 32)), ("contacts", (24,))):
        env = SkinObservation(Drop(), sensor, kind)
        assert env.observation_space["skin"].shape == size
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about wrappers, and spaces without bounds
            check_env(env, skip_render_check=True)
        env.reset(seed=3)
        for _ in range(12):
            observation, *_ = env.step(np.zeros(2, np.float32))
        assert np.abs(observation["skin"]).max() > 0
        assert env.observation_space.contains(observation)
    with pytest.raises(ModelError, match="no observation 'smell'; choose from voltages, image, contacts"):
        SkinObservation(Drop(), sensor, "smell")


def test_the_lines_of_the_guide_run(capsys: pytest.CaptureFixture[str]) -> None:
    guide = (Path(__file__).parents[1] / "docs" / "guide" / "robot.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    told: dict[str, Any] = {}
    exec(snippet.replace("* 1000", "* 3"), told)
    assert told["changes"].shape == (3, 108)
    x, y = map(float, re.findall(r"\(([-\d.]+), ([-\d.]+), 0.01\)", capsys.readouterr().out)[-1])
    assert abs(x - 0.03) < 5e-3
    assert abs(y + 0.02) < 5e-3
