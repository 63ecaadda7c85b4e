"""What the page asks of a running loop about modes and estimators, and what it is then told."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.engine import Engine
from ohmskin.engine.notices import Notices
from ohmskin.errors import ModelError
from ohmskin.inverse import Image
from ohmskin.inverse.estimators import Estimator, EstimatorSettings, FrameWise, gauss_newton
from ohmskin.scan import Difference, Frame
from ohmskin.skin import Fault, Mode, Skin, VirtualSkin
from ohmskin.view.session import PageSession
from ohmskin.view.wire import check_setup, read_command

AS_USUAL = {"estimator": "gauss-newton", "prior": "paper", "rule": "physical"}
PLACE = (0.08, 0.12)


class Slow:
    """Images as usual, later; none of a pressed skin."""

    def __init__(self, usual: FrameWise) -> None:
        self.usual = usual

    def reconstruct(self, *differences: Difference) -> Image:
        time.sleep(0.12)
        image = self.usual.estimator.reconstruct(*differences)
        if image.values.max() > 0.2:
            raise ModelError("no image of these data")
        return image


def slow(settings: EstimatorSettings) -> Estimator:
    """Slow."""
    usual = gauss_newton(settings)
    assert isinstance(usual, FrameWise)
    return FrameWise(Slow(usual), usual.cells)


class Page:
    """Stands in for the page: keeps what it is told, hands over commands as a browser would."""

    def __init__(self) -> None:
        self.setup: dict[str, Any] = {}
        self.told: list[dict[str, Any]] = []
        self.sent: list[dict[str, Any]] = []

    def show(self, setup: dict[str, Any]) -> None:
        self.setup = check_setup(setup)

    def commands(self) -> list[dict[str, Any]]:
        sent, self.sent = self.sent, []
        return sent

    def wants_frame(self) -> bool:
        return True

    def publish(self, header: dict[str, Any], *_: object) -> None:
        self.told.append(json.loads(json.dumps(header)))

    def close(self) -> None:
        pass


class Looker:
    """Somebody at the page of a virtual skin."""

    def __init__(self, session: PageSession, device: DirectDevice) -> None:
        self.session, self.device = session, device
        self.page: Page = session.view  # type: ignore[assignment]

    def send(self, kind: str, **fields: object) -> list[dict[str, Any]]:
        """Send a command, let the loop run a few cycles; what the page was told then."""
        self.page.sent.append(read_command(json.dumps({"type": kind, **fields}), self.page.setup))
        del self.page.told[:]
        for _ in range(8):
            self.session.step()
        return self.page.told


def missing(frame: Frame) -> Frame:
    return replace(frame, voltages=np.full_like(frame.voltages, np.nan))


@pytest.fixture(scope="module")
def calibrated() -> Iterator[Looker]:
    with pytest.MonkeyPatch.context() as patch:
        theirs = EntryPoint("slow", f"{__name__}:slow", "ohmskin.estimators")
        patch.setattr("ohmskin.registry.entry_points", lambda group: [theirs] if group == "ohmskin.estimators" else [])
        skin = Skin.load("paper")
        skin = replace(skin, imaging=replace(skin.imaging, bipolar=True))
        device = DirectDevice(VirtualSkin(skin, seed=3))
        with Engine(lambda: device, skin) as engine, PageSession(engine, "virtual:", Page(), False) as session:
            session.calibrate()
            yield Looker(session, device)


@pytest.fixture
def looker(calibrated: Looker) -> Iterator[Looker]:
    calibrated.send("mode", mode="16O")
    calibrated.send("estimator", **AS_USUAL)
    yield calibrated
    calibrated.send("lift_all")


def test_modes_come_with_plain_names_in_the_skins_order_and_those_of_the_paper_last(looker: Looker) -> None:
    shown = [(mode["name"], mode["title"], mode["available"]) for mode in looker.page.setup["modes"]]
    assert shown == [
        ("12B", "Rim of 12", True),
        ("16I", "Rim and inside", True),
        ("16O", "Adaptive, as in the paper", True),
        ("16P", "Adaptive, most precise", True),
        ("16T", "Tracking, fastest", True),
        ("16B", "Rim of 16", False),
    ]
    assert all(mode["summary"].endswith(".") for mode in looker.page.setup["modes"])
    assert looker.page.setup["modes"][-1]["why_not"] == "needs other electrodes: ohmskin live --skin paper-rim16"


def test_a_calibration_that_cannot_be_is_told_on_the_page_and_ends_nothing(
    looker: Looker, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(looker.device, "spoil", missing)
        told = looker.send("calibrate")
    assert any("every voltage of a frame is missing" in header["message"] for header in told)
    assert looker.send("pause", paused=False)[-1]["state"] == "running"


def test_an_estimator_is_prepared_and_then_used_in_every_mode(looker: Looker) -> None:
    looker.send("press", id="a", x=PLACE[0], y=PLACE[1], radius=8e-3, pressure=2e4)
    first, *_, last = looker.send("estimator", **AS_USUAL | {"estimator": "kalman", "prior": "matern"})
    assert first["preparing"] == "Adaptive, as in the paper (16O): estimator kalman, prior matern, rule physical"
    assert first["estimator"] == "gauss-newton"
    assert (last["preparing"], last["message"]) == ("", "")
    assert (last["estimator"], last["prior"], last["rule"]) == ("kalman", "matern", "physical")
    (contact,) = last["contacts"]
    assert np.hypot(contact["x"] - PLACE[0], contact["y"] - PLACE[1]) < 12e-3
    first, *_, last = looker.send("mode", mode="12B")
    assert first["preparing"].startswith("Rim of 12 (12B): estimator kalman")
    assert (last["mode"], last["estimator"]) == ("12B", "kalman")
    assert not any(told["preparing"] for told in looker.send("mode", mode="16O"))  # has been prepared before


def test_what_does_not_go_with_the_skin_is_told_and_changes_nothing(looker: Looker) -> None:
    last = looker.send("estimator", **AS_USUAL | {"estimator": "positive"})[-1]
    assert "estimator 'positive' on a skin whose contacts may lower the conductivity" in last["message"]
    assert {name: last[name] for name in AS_USUAL} == AS_USUAL
    assert last["state"] == "running"


def test_a_slow_estimator_says_what_rate_it_reaches_and_data_without_an_image_do_not_end_the_loop(
    looker: Looker,
) -> None:
    last = looker.send("estimator", **AS_USUAL | {"estimator": "slow"})[-1]
    assert last["message"].startswith("estimator slow takes 0.")
    assert last["message"].endswith(" frames/s")
    last = looker.send("press", id="a", x=PLACE[0], y=PLACE[1], radius=8e-3, pressure=2e4)[-1]
    assert last["message"] == "no image of these data"
    last = looker.send("mode", mode="16P")[-1]  # which reads contacts without the image
    assert last["message"] == "no image of these data"
    assert len(last["contacts"]) == 1
    looker.send("lift_all")
    last = looker.send("estimator", **AS_USUAL)[-1]
    assert last["estimator"] == "gauss-newton"


def test_presses_of_known_weights_are_saved_with_the_skin_as_newtons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    paper = Skin.load("paper")
    device = DirectDevice(VirtualSkin(paper, seed=3))
    with Engine(lambda: device, paper) as engine, PageSession(engine, "", Page(), False) as session:
        looker = Looker(session, device)
        looker.send("mode", mode="16O")
        session.calibrate()
        looker.send("begin")
        assert looker.send("save")[-1]["guided"].startswith("Newtons are not calibrated: 0 of 0 presses were detected")
        for k, (x, y) in enumerate([(0.06, 0.13), (0.12, 0.07), (0.14, 0.14), (0.07, 0.06)]):
            force = (2.0, 6.0)[k % 2]
            looker.send("weigh", force=force)
            for _ in range(2):
                looker.send("push", id="guide", x=x, y=y, radius=8e-3, force=force)
            looker.send("weigh", force=0.0)
            looker.send("lift", id="guide")
        told = looker.send("save")[-1]["guided"]
        assert f"Force calibration saved in {tmp_path / 'paper-calibrated.toml'}" in told
        assert "paper-calibrated-2.toml" in looker.send("save")[-1]["guided"]  # nothing is overwritten
    found = Skin.load(tmp_path / "paper-calibrated.toml").calibration
    assert found.mode == "16O"
    assert found.forces == (2.0, 6.0)
    assert found.layer_conductance == pytest.approx(paper.contact_layer.conductance, rel=0.3)


def test_a_lost_device_takes_no_new_press_and_gets_those_it_had_again() -> None:
    device = DirectDevice(VirtualSkin(Skin.load("paper"), seed=3))
    with Engine(lambda: device, Skin.load("paper")) as engine, PageSession(engine, "", Page(), False) as session:
        session.calibrate()
        looker = Looker(session, device)
        press = {"x": PLACE[0], "y": PLACE[1], "radius": 8e-3, "pressure": 2e4}
        looker.send("press", id="held", **press)
        device.gone = True
        assert looker.send("press", id="held", **press | {"x": 0.1})[-1]["state"] == "lost"
        told = looker.send("press", id="new", **press)[-1]
        assert [shown["id"] for shown in told["presses"]] == ["held"]
        assert (told["presses"][0]["x"], told["state"]) == (0.1, "lost")
        assert told["message"] == "device lost: the plug was pulled; reconnecting"


def test_how_far_the_calibration_of_another_device_is_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.engine.engine._RETRY_AFTER", 0.0)
    devices = [DirectDevice(VirtualSkin(Skin.load("paper"), seed=k), serial=k) for k in (1, 2)]
    pending = iter(devices)
    with Engine(lambda: next(pending), Skin.load("paper")) as engine, PageSession(engine, "", Page(), False) as session:
        session.calibrate()
        devices[0].gone = True
        told = Looker(session, devices[1]).send("lift_all")
    shares = [header["progress"] for header in told if header["state"] == "calibrating"]
    assert len(shares) > 10
    assert shares == sorted(shares)
    assert told[-1]["state"] == "running"
    assert told[-1]["progress"] is None


def test_the_page_is_told_what_is_doubted_where_and_both_thresholds(looker: Looker) -> None:
    last = looker.send("mode", mode="16O")[-1]
    assert last["findings"] == []
    assert last["base_threshold"] > 0
    assert last["threshold"] > 0
    assert last["base_threshold"] != last["threshold"]
    looker.device.blind = True  # voltages at electrode 5 clip
    try:
        (finding,) = looker.send("lift_all")[-1]["findings"]
    finally:
        looker.device.blind = False
    assert "clip" in finding["words"]
    assert finding["electrodes"] == []
    for _ in range(40):
        last = looker.send("lift_all")[-1]
    assert last["findings"] == []


def test_frames_without_any_image_do_not_end_the_loop(looker: Looker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looker.device, "spoil", missing)
    assert looker.send("mode", mode="16T")[-1]["state"] == "running"
    monkeypatch.undo()
    assert looker.send("lift_all")[-1]["state"] == "running"


def test_electrodes_that_were_bad_at_the_calibration_are_told_with_their_words(monkeypatch: pytest.MonkeyPatch) -> None:
    skin = Skin.load("paper")
    device = DirectDevice(VirtualSkin(skin, seed=3, faults=[Fault.parse("open 6")]))
    with Engine(lambda: device, skin) as engine, PageSession(engine, "virtual:", Page(), False) as session:
        session.calibrate()
        finding = Looker(session, device).send("lift_all")[-1]["findings"][0]
    assert finding["electrodes"] == [6]
    assert finding["words"].startswith("electrode 6: open")


def test_a_slow_estimator_is_told_of_once_and_not_any_more_when_another_is_used() -> None:
    told: list[str] = []
    notices = Notices(told.append)
    mode = Mode("one", drive="rim", reader="centroid")
    notices.pace(mode, 0.004, 2.0)  # something else is slow
    notices.pace(mode, 0.6, 0.0)  # not known yet
    assert told == []
    for _ in range(3):
        notices.pace(mode, 0.6, 1.5)
    assert told == ["estimator gauss-newton takes 0.6 s a frame on this machine: 1.7 frames/s"]
    assert notices.message == told[0]
    notices.pace(mode.using("kalman"), 0.004, 1.5)
    assert notices.message == ""
