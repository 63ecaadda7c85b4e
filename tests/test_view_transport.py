"""A recording led from the page: the commands, as a browser sends them, and what every browser is then told."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import SKIN, record_press

import ohmskin as ohm
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import State
from ohmskin.errors import ViewError
from ohmskin.mcap import RecordingReader, Role
from ohmskin.recording import Player, Recorder
from ohmskin.view.session import PageSession
from ohmskin.view.wire import CommandError, check_setup, read_command

CYCLES = 30
PRESSED = range(CYCLES // 5, CYCLES - CYCLES // 5)
RECORDING = {"recording": {"length": 10.0}}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("transport") / "press.mcap"
    record_press(file, cycles=CYCLES, images=0)
    return file


class Paper:
    """Stands in for the page: keeps the newest header, hands over commands as a browser would."""

    def __init__(self) -> None:
        self.setup: dict[str, Any] = {}
        self.header: dict[str, Any] = {}
        self.sent: list[dict[str, Any]] = []

    def show(self, setup: dict[str, Any]) -> None:
        self.setup = check_setup(setup)

    def send(self, kind: str, **fields: object) -> None:
        self.sent.append(read_command(json.dumps({"type": kind, **fields}), self.setup))

    def commands(self) -> list[dict[str, Any]]:
        sent, self.sent = self.sent, []
        return sent

    def wants_frame(self) -> bool:
        return True

    def publish(self, header: dict[str, Any], *_: object) -> None:
        self.header = json.loads(json.dumps(header))

    def close(self) -> None:
        pass


class Viewer:
    """Somebody who leads a recording from the page."""

    def __init__(self, path: Path, engine: ohm.Engine, device: ReplayDevice, session: PageSession) -> None:
        with RecordingReader(path) as reader:
            self.times = reader.times[reader.roles == Role.BASE]
        self.engine, self.device, self.page = engine, device, session.view
        self.step: Callable[[], ohm.Touch | None] = Player(engine).lead(session.step)
        session.calibrate()

    def send(self, kind: str, **fields: object) -> int:
        """Send a command and let the loop run until it has shown something; which cycle of the recording is shown."""
        self.page.send(kind, **fields)  # type: ignore[attr-defined]
        for _ in range(12):
            if self.step() is not None:
                break
        return self.shown

    @property
    def header(self) -> dict[str, Any]:
        return self.page.header  # type: ignore[attr-defined, no-any-return]

    @property
    def shown(self) -> int:
        return int(np.argmin(np.abs(self.times - self.header["recording"]["position"])))

    @property
    def ids(self) -> list[int]:
        return [contact["id"] for contact in self.header["contacts"]]


@pytest.fixture
def viewer(path: Path) -> Iterator[Viewer]:
    device = ReplayDevice(f"replay:{path}", speed=np.inf, loop=False)
    with ohm.Engine(lambda: device, SKIN) as engine, PageSession(engine, device.url, Paper(), False) as session:
        yield Viewer(path, engine, device, session)


def test_a_place_that_is_sought_is_shown_with_its_contacts_also_while_paused(viewer: Viewer) -> None:
    assert viewer.page.setup["device"]["url"] == viewer.device.path.name  # type: ignore[attr-defined]
    assert viewer.page.setup["recording"] == {"length": viewer.device.duration}  # type: ignore[attr-defined]
    viewer.send("pause", paused=True)
    assert viewer.engine.state is State.PAUSED
    middle = PRESSED[len(PRESSED) // 2]
    assert viewer.send("seek", position=viewer.times[middle]) == middle
    assert (viewer.header["state"], viewer.ids) == ("paused", [1])
    (contact,) = viewer.header["contacts"]
    assert (contact["x"], contact["y"]) == pytest.approx((0.06 + 1e-3 * middle, 0.12), abs=0.012)
    assert viewer.send("seek", position=viewer.times[2]) == 2
    assert (viewer.header["state"], viewer.ids) == ("paused", [])
    viewer.send("pause", paused=False)
    assert viewer.send("seek", position=viewer.times[middle]) == middle
    assert viewer.header["state"] == "running"
    assert [viewer.send("loop", on=False) for _ in range(3)] == [
        middle + 1,
        middle + 2,
        middle + 3,
    ]  # and goes on from there


def test_contacts_are_tracked_anew_after_a_seek_and_on_every_round(viewer: Viewer) -> None:
    def round_trip() -> list[list[int]]:
        rows = []
        for _ in range(CYCLES):
            assert viewer.step() is not None
            rows.append(viewer.ids)
        return rows

    viewer.device.loop = True
    first = round_trip()
    assert first[PRESSED[5]] == [1]
    assert round_trip() == first  # a contact that was followed on would have id 2
    viewer.send("seek", position=0.0)
    assert viewer.send("seek", position=viewer.times[PRESSED[10]]) == PRESSED[10]
    assert viewer.ids == [1]
    viewer.send("seek", position=0.0)
    assert viewer.ids == []


def test_steps_show_one_frame_after_the_other_and_stop_at_the_ends(viewer: Viewer) -> None:
    assert viewer.send("step", cycles=1) == 0  # the first frame that is shown at all
    assert viewer.engine.state is State.PAUSED
    assert [viewer.send("step", cycles=1) for _ in range(12)] == [*range(1, 13)]
    assert viewer.ids == [1]  # followed, as while it plays
    assert [viewer.send("step", cycles=-1) for _ in range(3)] == [11, 10, 9]
    assert viewer.ids == [1]
    viewer.page.send("step", cycles=-1)  # type: ignore[attr-defined]
    viewer.page.send("step", cycles=-1)  # type: ignore[attr-defined]
    assert viewer.send("step", cycles=1) == 8  # asked for at once: twice back and once on
    viewer.send("seek", position=viewer.times[1])
    assert [viewer.send("step", cycles=-1) for _ in range(3)] == [0, 0, 0]
    assert viewer.send("seek", position=viewer.device.duration) == CYCLES - 1
    assert [viewer.send("step", cycles=1) for _ in range(2)] == [CYCLES - 1, CYCLES - 1]
    assert viewer.engine.state is State.PAUSED
    assert viewer.header["recording"]["ended"]
    assert viewer.send("step", cycles=-1) == CYCLES - 2
    assert not viewer.header["recording"]["ended"]
    viewer.send("loop", on=True)
    viewer.send("seek", position=viewer.times[-1])
    assert viewer.send("step", cycles=1) == 0


def test_a_pause_shows_the_place_that_was_sought_before(viewer: Viewer) -> None:
    viewer.step()
    viewer.page.send("seek", position=viewer.times[20])  # type: ignore[attr-defined]
    assert viewer.send("pause", paused=True) == 20
    assert viewer.engine.state is State.PAUSED


def test_a_drag_shows_places_on_its_way_however_quick_it_is(viewer: Viewer) -> None:
    shown = set()
    for k in range(100):
        viewer.page.send("seek", position=viewer.times[9 + k // 10])  # type: ignore[attr-defined]
        if viewer.step() is not None:
            shown.add(viewer.shown)
    assert len(shown) > 5


def test_speed_and_loop_are_told_to_all(viewer: Viewer) -> None:
    viewer.send("speed", speed=0.25)
    assert viewer.device.speed == viewer.header["recording"]["speed"] == 0.25
    viewer.send("speed", speed=None)
    assert viewer.device.speed == math.inf
    assert viewer.header["recording"] == {
        "position": viewer.times[1],
        "length": viewer.device.duration,
        "ended": False,
        "speed": None,
        "loop": False,
    }
    viewer.send("loop", on=True)
    assert viewer.device.loop
    assert viewer.header["recording"]["loop"] is True


def test_play_begins_anew_at_the_end_and_goes_on_where_somebody_went(viewer: Viewer) -> None:
    def inject() -> list[int]:
        viewer.page.send("pause", paused=False)  # type: ignore[attr-defined]
        rows = []
        for _ in range(CYCLES + 14):
            if viewer.step() is not None:
                rows.append(viewer.shown)
        assert viewer.engine.state is State.PAUSED
        return rows

    assert inject() == [*range(CYCLES)]
    assert inject() == [*range(CYCLES)]
    assert viewer.send("seek", position=viewer.times[25]) == 25
    assert inject() == [*range(26, CYCLES)]  # and not once more from the beginning
    assert inject() == [*range(CYCLES)]


def test_every_frame_of_a_tracking_mode_can_be_sought(tmp_path: Path) -> None:
    record_press(tmp_path / "a.mcap", "16T", cycles=CYCLES, images=0)
    device = ReplayDevice(f"replay:{tmp_path / 'a.mcap'}", speed=np.inf, loop=False)
    with RecordingReader(tmp_path / "a.mcap") as reader:
        times = reader.times[reader.roles != Role.QUIET]
    with ohm.Engine(lambda: device, SKIN) as engine:
        player = Player(engine)
        engine.calibrate()
        for cycle, pressed in ((PRESSED[10], True), (2, False), (PRESSED[12], True)):
            device.seek(float(times[cycle]), lead=8)
            led = 0
            while device.leading:
                player.step()
                led += 1
            assert device.position == times[cycle]
            assert led == min(cycle, 8)
            touch = player.step()
            assert touch is not None
            assert [contact.id for contact in touch.contacts] == [1] * pressed
        device.step(-2)
        assert device.position == times[PRESSED[12] - 1]


def test_a_round_begins_with_the_mode_and_the_calibration_of_the_beginning(tmp_path: Path) -> None:
    from recordings import Bench

    with (
        Recorder(tmp_path / "a.mcap", SKIN, images=0) as recorder,
        ohm.Engine(lambda: recorder.tee(Bench()), SKIN, "16I") as engine,
    ):
        recorder.watch(engine)
        engine.calibrate()
        for mode in ("16I", "16I", "16O", "", "16O", "12B"):
            if not mode:
                engine.calibrate()
                continue
            engine.set_mode(mode)
            touch = engine.step()
            assert touch is not None
            recorder.publish(touch)
    device = ReplayDevice(f"replay:{tmp_path / 'a.mcap'}", speed=np.inf, loop=True)
    with ohm.Engine(lambda: device, SKIN) as engine:
        player = Player(engine)
        engine.calibrate()
        rounds = [[(t.mode.name, t.health.noise) for _ in range(5) if (t := player.step())] for _ in range(2)]
    assert [mode for mode, _ in rounds[0]] == ["16I", "16I", "16O", "16O", "12B"]
    assert rounds[1] == rounds[0]


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"type": "seek", "position": -0.1}, "position must be from 0 to 10"),
        ({"type": "seek", "position": 10.1}, "position must be from 0 to 10"),
        ({"type": "seek", "position": math.nan}, "position must be from 0 to 10"),
        ({"type": "seek", "position": 10**400}, "position must be from 0 to 10"),
        ({"type": "seek", "position": "1"}, "position must be a number"),
        ({"type": "seek", "position": None}, "position must be a number"),
        ({"type": "seek"}, "seek needs exactly these fields: position"),
        *(({"type": "step", "cycles": cycles}, "cycles must be 1 or -1") for cycles in (0, 2, 1.0, True, "1", None)),
        *(
            ({"type": "speed", "speed": speed}, "from 0.01 to 1000, or null for as fast as it can")
            for speed in (0, -1, 1001, math.inf, math.nan)
        ),
        *(({"type": "speed", "speed": speed}, "speed must be a number, or null") for speed in (True, "2", [])),
        *(({"type": "loop", "on": on}, "on must be true or false") for on in (1, None, "yes")),
    ],
)
def test_bad_values_are_refused(fields: dict[str, object], says: str) -> None:
    with pytest.raises(CommandError, match=says):
        read_command(json.dumps(fields), RECORDING)


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "seek", "position": 0.0},
        {"type": "step", "cycles": 1},
        {"type": "speed", "speed": None},
        {"type": "loop", "on": True},
    ],
)
@pytest.mark.parametrize("setup", [{}, {"recording": None}])
def test_other_devices_cannot_be_led(fields: dict[str, object], setup: dict[str, Any]) -> None:
    with pytest.raises(CommandError, match="not a recording"):
        read_command(json.dumps(fields), setup)


@pytest.mark.parametrize("recording", [{}, {"length": -1.0}, {"length": math.inf}, {"length": "long"}])
def test_a_recording_without_a_length_is_no_setup(recording: dict[str, object]) -> None:
    from test_view import SETUP

    with pytest.raises(ViewError):
        check_setup(SETUP | {"recording": recording})
