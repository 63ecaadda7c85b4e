"""Gestures: told of contacts over time, with what is not one of them left unknown."""

import json
from dataclasses import replace

import numpy as np
import pytest
from direct import DirectDevice

from ohmskin.contacts import Contact
from ohmskin.engine import Engine
from ohmskin.errors import DataError
from ohmskin.gestures import GESTURES, UNKNOWN, Gesture, GestureFollower, GestureModel, GestureReader
from ohmskin.gestures.simulate import Stream, simulated
from ohmskin.skin import Skin, VirtualSkin


def last(stream: Stream, model: GestureModel | None = None) -> Gesture:
    """What is told of a stream in the end; nothing told is unknown."""
    follow, told = GestureFollower(model), Gesture()
    for time, contacts in stream:
        told = follow(time, contacts) or told
    return told


def moving(*paths: np.ndarray, period: float = 0.02, strength: float = 1e-4) -> Stream:
    """Contacts on paths (n, 2), a place a frame, and half a second of nothing."""
    touched = [
        (period * k, tuple(Contact(tuple(p[k].tolist()), 1e-4, strength, 1.0, 0.5, i) for i, p in enumerate(paths)))
        for k in range(len(paths[0]))
    ]
    return touched + [(touched[-1][0] + period * k, ()) for k in range(1, 26)]


def line(start: tuple[float, float], end: tuple[float, float], frames: int) -> np.ndarray:
    return np.linspace(start, end, frames)


def test_plain_gestures_are_told() -> None:
    at = (0.1, 0.1)
    assert last(moving(line(at, at, 6))).name == "tap"
    assert last(moving(line((0.04, 0.1), (0.16, 0.12), 40))).name == "stroke"
    assert last(moving(line(at, at, 100))).name == "push"
    assert last(moving(*(line(p, p, 80) for p in (at, (0.14, 0.1), (0.12, 0.14))))).name == "grasp"


def test_simulated_gestures_that_were_not_trained_on_are_told() -> None:
    """Others than those of training: another seed, smaller and larger skins."""
    told = [(gesture, last(stream).name) for gesture, stream in simulated(71, 120, size=(0.08, 0.7))]
    assert np.mean([one == other for one, other in told]) > 0.9
    assert np.mean([other not in (one, UNKNOWN) for one, other in told]) < 0.05


def test_what_is_no_gesture_stays_unknown() -> None:
    random = np.random.default_rng(3)
    flicker = moving(*(random.uniform(0, 0.2, (60, 2)) for _ in range(4)))
    wipe = moving(*(line((0.02, y), (0.18, y), 25) for y in (0.05, 0.1, 0.15)))  # a hand over the skin
    assert {last(flicker).name, last(wipe).name} == {UNKNOWN}


def test_the_first_moment_tells_nothing_yet_and_the_end_is_told_for_good() -> None:
    reader = GestureReader()
    state = reader.start()
    stream = moving(line((0.1, 0.1), (0.1, 0.1), 100))
    told = []
    for time, contacts in stream:
        state = reader.update(state, time, contacts)
        told.append(state.gesture)
    assert told[0] is not None
    assert told[0].name != "push"
    assert told[60] is not None
    assert (told[60].name, told[60].ended) == ("push", False)
    ended = [one for one in told if one is not None and one.ended]
    assert ended
    assert all(one.name == "push" and one.duration == pytest.approx(1.98) for one in ended)
    later = reader.update(state, stream[-1][0] + 1, ())
    assert later.gesture is None
    back = reader.update(state, 0.0, stream[0][1])  # a recording that is wound back
    assert back.episode is not None
    assert back.episode.frames == 1


def test_a_model_is_data_and_a_bad_one_is_refused_in_words() -> None:
    model = GestureModel.load()
    again = GestureModel.parse(model.dump())
    figures = np.random.default_rng(0).normal(size=(5, len(model.middle)))
    assert again.probabilities(figures) == pytest.approx(model.probabilities(figures))
    told = json.loads(model.dump())
    for bad in (
        "",
        "[]",
        json.dumps(told | {"gestures": ["tap"]}),
        json.dumps(told | {"middle": told["middle"][:-1]}),
        json.dumps(told | {"limit": float("nan")}),
        json.dumps(told | {"layers": []}),
        json.dumps(told | {"spread": [0.0] * len(told["spread"])}),
    ):
        with pytest.raises(DataError, match="not a model of gestures"):
            GestureModel.parse(bad)
    with pytest.raises(DataError, match="cannot read"):
        GestureModel.load("no/such/file.json")


def test_training_makes_a_model_that_tells_most() -> None:
    pytest.importorskip("sklearn")
    from ohmskin.gestures.train import train_gestures

    model = train_gestures(seed=5, count=400)
    right = [last(stream, model).name == gesture for gesture, stream in simulated(73, 60)]
    assert np.mean(right) > 0.7  # of 25, chance, and 95 of the model that ships, trained on six times as many


def test_the_loop_tells_a_gesture(monkeypatch: pytest.MonkeyPatch) -> None:
    """It classifies it when somebody asks."""
    skin, asked, classify = Skin.load("paper-rim16"), list[str](), GestureModel.classify
    monkeypatch.setattr(GestureModel, "classify", lambda *given: asked.append("") or classify(*given))
    with Engine(lambda: DirectDevice(VirtualSkin(skin, seed=1)), skin, "16B") as engine:
        engine.calibrate()
        engine.press(1, at=(0.1, 0.1), radius=8e-3, pressure=20e3)
        touches = [engine.step() for _ in range(6)]
    assert touches[-1] is not None
    assert not asked
    assert touches[-1].gesture is not None
    assert touches[-1].gesture.name in (*GESTURES, UNKNOWN)
    assert set(touches[-1].gesture.as_json()) == {"name", "confidence", "began", "duration", "ended"}
    assert replace(touches[-1].gesture, name="tap").as_json()["name"] == "tap"
    assert len(asked) == 1
