"""The auxiliary channel: one sensor beside the electrodes that feels all of the skin: on the wire, in recordings, and
in the forces of contacts."""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.calibrate import PressSample, fit_auxiliary
from ohmskin.contacts import Contact
from ohmskin.device.capabilities import Feature
from ohmskin.device.messages import FrameData
from ohmskin.device.virtual import VirtualDevice
from ohmskin.drive import complete_pattern
from ohmskin.engine import Engine
from ohmskin.engine.notices import Notices
from ohmskin.errors import ProtocolError
from ohmskin.mcap import RecordingReader, Role
from ohmskin.mcap.messages import decode_frame, encode_frame
from ohmskin.recording import Recorder
from ohmskin.recording.export import FRAME_COLUMNS, frame_rows
from ohmskin.scan import Frame
from ohmskin.sensing.total import TotalForce
from ohmskin.skin import Calibration, Press, Skin, VirtualSkin
from ohmskin.skin.auxiliary import Auxiliary

PAPER = Skin.load("paper")
AIR = replace(PAPER, auxiliary=Auxiliary("pressure", gain=40.0, noise=2.0))
FOAM = PAPER.contact_layer.foam_spread
LAYER = Calibration(layer_conductance=PAPER.contact_layer.conductance, layer_exponent=PAPER.contact_layer.exponent)


def contact(force: float | None = None, std: float | None = None, strength: float = 1e-4) -> Contact:
    """A contact of that force."""
    return Contact((0.1, 0.1), 1e-4, strength, 1.0, 1.0, force=force, force_std=std, pressure=force and 1e4 * force)


def frame(reading: float | None) -> Frame:
    """A frame with that reading."""
    pattern = complete_pattern(4)
    return Frame(pattern, np.zeros(pattern.n_meas), np.ones(pattern.n_inj), auxiliary=reading)


def test_a_device_tells_it_with_each_frame() -> None:
    press = Press((0.1, 0.1), 8e-3, 20e3)
    with VirtualDevice("virtual:", skin=AIR, seed=1, realtime=False) as device:
        assert Feature.AUXILIARY in device.capabilities.features
        pattern = complete_pattern(16)
        quiet = device.scan(pattern)
        device.press(0, press.position, press.radius, press.pressure)
        touched = device.scan(pattern)
    assert quiet.voltages.shape == (pattern.n_meas,)
    assert quiet.auxiliary == pytest.approx(0.0, abs=8.0)
    assert touched.auxiliary == pytest.approx(40 * press.force(FOAM), abs=8.0)


def test_a_frame_with_and_without_it_are_not_taken_for_each_other() -> None:
    with_it, without = FrameData.of(frame(3.0)), FrameData.of(frame(None))
    pattern = complete_pattern(4)
    assert with_it.frame(pattern, auxiliary=True).auxiliary == 3.0
    assert without.frame(pattern).auxiliary is None
    for data, auxiliary in ((with_it, False), (without, True)):
        with pytest.raises(ProtocolError, match="digest, injections, measurements"):
            data.frame(pattern, auxiliary)


@pytest.mark.parametrize("mode", ["", "16P", "a mode"])
def test_recordings_keep_it_and_those_without_are_read(mode: str) -> None:
    for reading in (3.5, None, float("nan")):
        data = encode_frame(frame(reading), 10**9, 1.0, Role.BASE, mode)
        kept = decode_frame(data).frame(complete_pattern(4)).auxiliary
        assert kept == reading or (reading is not None and np.isnan(reading) and kept is not None and np.isnan(kept))
        before = data[: data.index(mode.encode() + b"\0", 40) + len(mode) + 1] if mode else None
        if before is not None:  # as recorded before there was such a channel
            assert decode_frame(before).auxiliary is None
            assert decode_frame(before).mode == mode


def test_the_exported_table_of_frames_has_it(tmp_path: Path) -> None:
    with Recorder(tmp_path / "air.mcap", AIR) as recorder, recorder.tee(DirectDevice(VirtualSkin(AIR, 5))) as device:
        readings = [device.scan(next(complete_pattern(16).split(24))).auxiliary for _ in range(3)]
    with RecordingReader(tmp_path / "air.mcap") as reader:
        rows = list(frame_rows(reader))
    assert list(dict.fromkeys(row[FRAME_COLUMNS.index("auxiliary")] for row in rows)) == readings


class Known:
    """What `TotalForce` asks a skin's model for."""

    def __init__(self, skin: Skin, *rest: float) -> None:
        self.skin, self.quiet = skin, type("Quiet", (), {"rest": float(np.mean(rest)), "auxiliary": list(rest)})()


def fused(contacts: tuple[Contact, ...], newtons: float, skin: Skin = AIR) -> tuple[Contact, ...]:
    """Contacts brought to a total."""
    return TotalForce(Known(skin, 100.0, 100.0))(contacts, [frame(100.0 + 40.0 * newtons)])  # type: ignore[arg-type]


def test_the_total_is_in_newtons_and_none_where_nothing_measures_it() -> None:
    channel, none = (TotalForce(Known(skin, 100.0, 100.0)) for skin in (AIR, PAPER))  # type: ignore[arg-type]
    assert channel.known_total([frame(100.0 + 40.0 * 7), frame(100.0 + 40.0 * 8)]) == pytest.approx(7.5)
    assert channel.known_total([frame(None)]) is None
    assert none.known_total([frame(100.0)]) is None


def test_the_less_sure_force_changes_more_and_all_add_up() -> None:
    sure, unsure = fused((contact(5.0, 0.2), contact(5.0, 2.0)), 12.0)
    assert sure.force is not None
    assert unsure.force is not None
    assert sure.force + unsure.force == pytest.approx(12.0, abs=0.1)
    assert unsure.force - 5 == pytest.approx(100 * (sure.force - 5), rel=0.01)
    assert unsure.force_std is not None
    assert unsure.force_std < 0.5
    assert unsure.pressure == pytest.approx(1e4 * unsure.force)


def test_without_calibration_contacts_share_the_total_by_strength() -> None:
    one, other = fused((contact(strength=3e-4), contact(strength=1e-4)), 8.0)
    assert (one.force, other.force) == (pytest.approx(6.0), pytest.approx(2.0))
    assert other.force_std is not None
    assert other.force_std > 0.3 * 2.0
    (alone,) = fused((contact(),), 8.0)
    assert alone.force == pytest.approx(8.0)
    assert alone.force_std == pytest.approx(np.hypot(2.0 / 40 * np.sqrt(1.5), 0.02 * 8.0), rel=0.1)


def test_a_contact_that_tells_no_force_yet_leaves_the_others_as_sure_as_they_are() -> None:
    known, new = fused((contact(5.0, 0.2), contact()), 12.0)
    assert known.force == pytest.approx(5.0, abs=0.1)
    assert new.force == pytest.approx(7.0, abs=0.1)


def test_a_total_of_nothing_is_no_surer_than_the_channel() -> None:
    (light,) = fused((contact(),), 0.0)
    assert light.force == 0.0
    assert light.force_std is not None
    assert light.force_std > 0.03  # the channel's own noise is 0.05 N


def test_a_total_that_contacts_cannot_have_or_that_is_not_there_changes_nothing() -> None:
    given = (contact(5.0, 0.2), contact(5.0, 0.3))
    assert fused(given, 30.0) == given  # a palm beside the contacts
    assert fused((contact(5.0, 2.0), contact()), -2.0) == (contact(5.0, 2.0), contact())  # its sign is wrong
    assert fused(given, float("nan")) == given
    assert fused(given, 12.0, PAPER) == given
    assert TotalForce(Known(AIR, 100.0))(given, [frame(None)]) == given  # type: ignore[arg-type]


def said(readings: Callable[[int], float | None], *forces: float, rest: float = 100.0, count: int = 40) -> list[str]:
    """What a loop says over so many frames with contacts of these forces, a tenth of a second apart."""
    told = list[str]()
    notices, quiet = Notices(told.append), rest + np.random.default_rng(0).normal(0, 2, 40)
    alone = tuple(contact(force, 0.2 * force) for force in forces)
    percept: Any = SimpleNamespace(contacts=tuple(contact(0.0) for _ in forces), without_total=alone)
    for number in range(count):
        percept.frames = [replace(frame(readings(number)), time=0.1 * number)]
        notices.auxiliary(Known(AIR, *quiet), percept)  # type: ignore[arg-type]
    return told


def test_a_channel_that_is_silent_stuck_or_unlike_the_contacts_is_told_once() -> None:
    noise = np.random.default_rng(1).normal(0, 2, 40)
    for readings, forces, rest, words in (
        (lambda _: None, (), 100.0, "reads nothing, and forces are without it"),
        (lambda _: np.nan, (5.0,), 100.0, "reads nothing, and forces are without it"),
        (lambda k: 300 + noise[k], (5.0,), np.nan, "read nothing at rest and is not used"),
        (lambda _: 100.0, (0.0,), 100.0, "has stuck at 100 Pa, and forces are without it"),
        (lambda k: -100 + noise[k], (0.0,), 100.0, r"shows -\S+ N, and forces are without it; its sign"),
        (lambda k: 20100 + noise[k], (5.0,), 100.0, r"shows \S+ N, the contacts 5 N, and forces are without it; check"),
        (lambda k: 100 + noise[k], (5.0,), 100.0, "the contacts 5 N, and forces are without it; check its wire"),
        (lambda k: 100 + 60 + noise[k], (2.0, 3.0), 100.0, r"shows 1\.\d+ N, the contacts 5 N"),
        (lambda k: 100 + 600 + noise[k], (5.0,), 100.0, r"shows 1\d(\.\d)? N, the contacts 5 N"),
    ):
        (told,) = said(readings, *forces, rest=rest)
        assert re.search(words, told)
    for quiet in ((), (5.0,), (2.0, 3.0)):
        readings = 100 + 40 * sum(quiet) + noise
        assert said(readings.__getitem__, *quiet) == []
    assert said(lambda k: 100 + noise[k] if k % 5 else np.nan) == []
    assert said(lambda k: np.nan if k < 20 else 100 + noise[k])[1:] == ["the auxiliary channel is plausible again"]


def test_presses_of_known_force_tell_its_gain() -> None:
    random = np.random.default_rng(3)
    forces = np.geomspace(1, 10, 8)
    samples = [
        PressSample((0.1, 0.1), force, 1e-4, True, auxiliary=7 + 40 * force * random.normal(1, 0.03))
        for force in forces
    ]
    found = fit_auxiliary(samples, 7.0, Calibration())
    assert found.auxiliary_gain == pytest.approx(40, rel=0.03)
    assert 0.01 < found.auxiliary_error < 0.06
    assert replace(AIR, calibration=found).calibrated_auxiliary.gain == found.auxiliary_gain
    nothing = [replace(sample, auxiliary=float("nan")) for sample in samples]
    assert fit_auxiliary(nothing, float("nan"), Calibration()) == Calibration()


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    """A loop with a skin that tells forces and has the channel."""
    with Engine(lambda: DirectDevice(VirtualSkin(AIR, 5)), replace(AIR, calibration=LAYER)) as engine:
        engine.calibrate()
        yield engine


def felt(engine: Engine, *presses: Press) -> list[float]:
    """The force felt at each press; NaN where none is (N)."""
    engine.forget()
    for number, press in enumerate(presses):
        engine.press(number, press.position, press.radius, press.pressure)
    touches = [touch for touch in (engine.step() for _ in range(20)) if touch is not None]
    for number, press in enumerate(presses):
        engine.press(number, press.position, press.radius, 0.0)
    found = []
    for press in presses:
        near = [c for c in touches[-1].contacts if np.hypot(*np.subtract(c.position, press.position)) < 0.01]
        found.append(near[0].force if near and near[0].force is not None else np.nan)
    return found


@pytest.mark.parametrize(
    ("share", "noise", "words"),
    [
        (0.0, 0.0, "has stuck"),
        (0.0, 2.0, "the contacts"),  # dead, with the noise of its amplifier
        (0.3, 0.0, "the contacts"),
        (3.0, 0.0, "the contacts"),
    ],
)
def test_a_channel_that_has_stuck_is_dead_or_has_a_wrong_gain_is_told_and_forces_go_on_without_it(
    share: float, noise: float, words: str
) -> None:
    random = np.random.default_rng(7)
    with Engine(lambda: DirectDevice(VirtualSkin(AIR, 5)), replace(AIR, calibration=LAYER)) as engine:
        engine.calibrate()
        at_rest = engine.known.quiet.rest  # type: ignore[union-attr]
        press = Press((0.1, 0.1), 8e-3, 20e3)
        engine.press(0, press.position, press.radius, press.pressure)
        engine.device.spoil = lambda frame: replace(  # type: ignore[attr-defined]
            frame, auxiliary=at_rest + share * (frame.auxiliary - at_rest) + random.normal(0, noise)
        )
        began = time.monotonic()
        while not engine.message and time.monotonic() < began + 30:
            engine.step()
        assert words in engine.message
        touch = next(engine.touches())
        assert touch.percept.total_force is None
        (found,) = touch.contacts
    assert found.force == pytest.approx(press.force(FOAM), rel=0.3)


def some_press(random: np.random.Generator) -> Press:
    """A press of 1 to 30 N somewhere."""
    x, y = random.uniform(0.02, 0.18, 2)
    radius = random.uniform(6e-3, 11e-3)
    force = np.exp(random.uniform(np.log(1.0), np.log(30.0)))
    return Press((x, y), radius, force / Press((x, y), radius, 1.0).force(FOAM))


def test_single_contacts_are_within_a_tenth(engine: Engine) -> None:
    """Found, of 24 presses: 0.5 to 0.8 % in the median."""
    random = np.random.default_rng(12)
    single = [felt(engine, one)[0] / one.force(FOAM) - 1 for one in (some_press(random) for _ in range(6))]
    assert np.median(np.abs(single)) < 0.1
    assert engine.message == ""


def test_each_of_three_is_within_a_fifth_in_the_median(engine: Engine) -> None:
    """Found, of 36 times three: 18 % (11 to 27 %) in the median, half of them within 20 %."""
    errors = []
    for seed in (21, 22, 23):
        random = np.random.default_rng(seed)
        for _ in range(4):
            some = [
                replace(some_press(random), position=(0.04 + 0.06 * n, y))
                for n, y in enumerate(random.uniform(0.03, 0.17, 3))
            ]
            errors += [told / one.force(FOAM) - 1 for told, one in zip(felt(engine, *some), some, strict=True)]
    assert np.nanmedian(np.abs(errors)) < 0.2
    assert np.isfinite(errors).mean() > 0.9
    assert engine.message == ""


def test_a_skin_file_keeps_it(tmp_path: Path) -> None:
    path = tmp_path / "air.toml"
    path.write_text(AIR.dump())
    assert Skin.load(path) == AIR
    assert AIR.tells_force
    assert not PAPER.tells_force
