"""What fits and tracking cost: frames of the paper's virtual skin, read again and again; and their arithmetic."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from ohmskin.bench.clock import Effort, Job, duration, in_turns
from ohmskin.bench.figure import Figure
from ohmskin.contacts import Solution
from ohmskin.scan import Difference
from ohmskin.sensing import Sensor, SkinModel, build
from ohmskin.sensing.build import drive_of
from ohmskin.sensing.modes import mode_named
from ohmskin.skin import Press, Skin, VirtualSkin

_PRESSES = [Press((0.04, 0.11), 8e-3, 20e3), Press((0.15, 0.06), 8e-3, 10e3), Press((0.1, 0.16), 8e-3, 15e3)]
_REPEATS, _SETTLED, _MEASURED = 10, 24, 40  # quiet frames; frames of tracking before the clock starts, and after


def fitting(effort: Effort) -> Iterator[Figure]:
    """Reading frames of the default mode by fits, and tracking, with what is scanned left out."""
    skin = Skin.load("paper")
    device = VirtualSkin(skin, seed=1)
    modes = [mode_named(skin, name) for name in ("16P", "16T")]
    patterns = {pattern for mode in modes for pattern in drive_of(mode, skin).patterns}
    known = SkinModel(skin, skin.transfer_model(), [device.scan(p) for _ in range(_REPEATS) for p in patterns])
    precise, tracking = (build(mode, known) for mode in modes)
    jobs: dict[str, Job] = {}
    for count in (1, 2):
        scans, found = _fitted(precise, device, count)
        nominal, inflated = known.fitter.information(*scans)

        def read(scans: Sequence[Difference] = scans, found: Solution = found) -> None:
            known.fitter.fit_information(*known.fitter.information(*scans), before=found)

        jobs[f"read {count}"] = read
        if count == 1:
            jobs["afresh"] = partial(known.fitter.fit, *scans)
            jobs["test"] = partial(known.fitter.split, nominal, inflated, found, 0)
    for count in (1, 3):
        jobs[f"track {count}"] = _tracked(tracking, device, count)
    spent = in_turns(jobs, 3 * effort.seconds, least=5)
    afresh = f"looked for afresh {duration(float(np.median(spent['afresh'])))}"
    yield Figure.median("a frame of 16P with one contact, read by a fit", spent["read 1"], "s", most=2e-4, note=afresh)
    yield Figure.median("a frame of 16P with two contacts, read by a fit", spent["read 2"], "s", most=5e-4)
    yield Figure.median("whether one contact is two, by the data of a frame", spent["test"], "s", most=6e-4)
    note = "the mean of 40 frames; with what is scanned, the image and the look at faults left out"
    for count, most in ((1, 4e-4), (3, 8e-4)):
        name = f"a frame of 16T, {count} contact{'s' * (count > 1)} tracked"
        yield Figure.median(name, spent[f"track {count}"] / _MEASURED, "s", most=most, note=note)


def _touched(sensor: Sensor, device: VirtualSkin, count: int, frames: int) -> list[tuple[Difference, ...]]:
    """The changes of so many frames of a skin pressed at so many places, as the sensor asks for them."""
    device.reset(count, _PRESSES[:count])
    state, taken = sensor.start(), []
    for _ in range(frames):
        state, percept = sensor.step(state, device.scan)
        taken.append(tuple(sensor.known.difference(frame) for frame in percept.frames))
    return taken


def _fitted(sensor: Sensor, device: VirtualSkin, count: int) -> tuple[tuple[Difference, ...], Solution]:
    scans = _touched(sensor, device, count, 4)[-1]
    return scans, sensor.known.fitter.fit(*scans)


def _tracked(sensor: Sensor, device: VirtualSkin, count: int) -> Job:
    """Follows contacts through frames, from the state that they have settled to."""
    follow = sensor.reader.filter  # type: ignore[attr-defined]
    frames = [scan for (scan,) in _touched(sensor, device, count, _SETTLED + _MEASURED)]
    settled = follow.start()
    for scan in frames[:_SETTLED]:
        settled = follow.update(settled, scan, 0.01)

    def track() -> None:
        state = settled
        for scan in frames[_SETTLED:]:
            state = follow.update(state, scan, 0.01)

    return track
