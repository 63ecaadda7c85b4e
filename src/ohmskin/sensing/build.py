"""From a mode to a sensor: its parts by their names, gamma_0 learned from the quiet frames, compiled where possible."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ohmskin.contacts import ContactFinder, learn_threshold
from ohmskin.drive import DRIVES, Drive, DriveSettings, Fixed, Target, WithDriven
from ohmskin.errors import DataError, ModelError
from ohmskin.inverse import PRIORS, RULES
from ohmskin.inverse.estimators import ESTIMATORS, Estimator, check_choice
from ohmskin.registry import Plugin, Registry, naming
from ohmskin.scan import Frame
from ohmskin.sensing.compiled import compiled
from ohmskin.sensing.confidence import (
    common_change,
    common_confidence,
    crowd_confidence,
    fit_confidence,
    image_confidence,
    image_misfit,
    quiet_confidence,
    scaled_confidence,
)
from ohmskin.sensing.consensus import consensus
from ohmskin.sensing.forces import forces_of
from ohmskin.sensing.learned import learned
from ohmskin.sensing.locator import Locator
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.modes import RECORDED, recorded_mode
from ohmskin.sensing.readers import DetectionReader, Reader, centroid, fit, tracked
from ohmskin.sensing.sensor import Percept, Sensor, Thresholds
from ohmskin.skin import Mode, Skin

READERS: Registry[Callable[[SkinModel, Estimator, float], Reader]] = Registry(
    "reader",
    "ohmskin.readers",
    {"centroid": centroid, "fit": fit, "consensus": consensus, "tracked": tracked, "learned": learned},
    ModelError,
    Reader,
)
"""Readers by name."""

_LEAST_QUIET = 8  # images, below which a threshold learned from them would be luck
_SIGMAS = 5.0  # height of a threshold above the largest predicted noise, where it cannot be learned
_REHEARSED = (1, 1, 1, 2, 2)  # contacts there in each frame
_PATIENCE = 2.0  # s to learn thresholds in, of slow estimators


def drive_of(mode: Mode, skin: Skin, driven: bool = True) -> Drive:
    """The drive of a mode.

    Args:
        mode: Names the drive.
        skin: The skin to drive.
        driven: Whether the device can measure electrodes that carry the current; without it, modes do without.

    Raises:
        PatternError: If there is none of that name, or the skin does not allow it.
    """
    driven = driven and mode.driven
    settings = DriveSettings(skin.electrodes, partial(skin.design, driven), skin.imaging.pairs, skin.domain.period)
    drive = DRIVES[mode.drive](settings, mode.injections)
    return WithDriven(drive) if driven else drive


def check_parts(mode: Mode) -> tuple[Plugin, ...]:
    """The parts of a mode that other packages made.

    Raises:
        OhmskinError: If there is no part of a name, or they do not go together; the message lists those there are.
    """
    parts: list[tuple[Registry[Any], str]] = [(DRIVES, mode.drive), (READERS, mode.reader)]
    parts += [(ESTIMATORS, mode.estimator), (PRIORS, mode.prior), (RULES, mode.rule)]
    for table, name in parts:
        if name not in table and name not in (RECORDED.drive, "pixels"):
            table[name]  # raises
    check_choice(mode.estimator, mode.prior, mode.rule)
    return tuple(found for table, name in parts if (found := table.plugin(name)))


def build(mode: Mode, known: SkinModel, drive: Drive | None = None, fast: bool = True) -> Sensor:
    """The sensor of a mode.

    Args:
        mode: Names drive, reader, estimator and prior.
        known: The model of the quiet skin.
        drive: An existing drive, such as the recorded pattern.
        fast: Whether it may use a compiled implementation, which takes a while on a machine that has never compiled it.

    Raises:
        PatternError: If there is no such drive, or the skin does not allow it, or its quiet frames do not cover it.
        ModelError: If there is no such reader, estimator, prior or rule, or it does not go with the skin.
    """
    drive = drive or drive_of(mode, known.skin, known.quiet.driven is not None)
    plugins = check_parts(mode)
    with naming(*plugins):
        sensor = _built(mode, known, drive, fast)
        if plugins:  # whose faults show now, not with the first frame
            sensor.step(sensor.start(), lambda pattern: known.quiet.scan(pattern, 0))
    sensor.plugins = plugins
    return sensor


def _built(mode: Mode, known: SkinModel, drive: Drive, fast: bool) -> Sensor:
    estimator = known.estimator(mode.estimator, mode.prior, mode.rule)
    imaging = known.skin.imaging
    if known.model.mesh.nodes.shape[1] != 2 and mode.reader != "centroid":
        raise ModelError(f"reader {mode.reader!r} needs a flat sheet; on surfaces in space use reader 'centroid'")
    finder = ContactFinder(np.inf, imaging.fraction, imaging.dip, imaging.bipolar)
    part = drive.scans == 1 and drive.patterns[0].n_inj > drive.injections
    window = imaging.pairs if part else 0
    quick = known.one_step(estimator)
    locator = Locator(quick, finder)
    blind = Sensor(
        known, drive, READERS["centroid"](known, estimator, np.inf), locator, Thresholds(0, 0), mode.fuse, window
    )
    thresholds, seconds = _learned(blind, finder)
    reader = READERS[mode.reader](known, estimator, thresholds.final)
    finder = ContactFinder(thresholds.base, imaging.fraction, imaging.dip, imaging.bipolar)
    locator = Locator(quick, finder, getattr(reader, "fitter", None))
    middle = known.model.mesh.centroids[:, :2].mean(axis=0)
    drive.next([Target(middle, 1e-6 * np.eye(2), 1e-4, imaging.mesh_size)], 1)  # makes its tables, if it has any, now
    sensor = Sensor(known, drive, reader, locator, thresholds, mode.fuse, window, forces_of(known, mode))
    sensor.implementation, sensor.seconds = compiled(sensor, mode) if fast else None, seconds
    _rehearse(sensor)
    return sensor


def perceive(known: SkinModel, frame: Frame, mode: Mode | None = None) -> Percept:
    """Contacts and image of one frame of any pattern.

    Args:
        known: The model of the quiet skin; its quiet frames cover the frame's pattern.
        frame: The frame.
        mode: Names reader, estimator, prior and rule; its drive does not count. Unless given, `recorded_mode`, on
            surfaces in space with the reader `centroid`.

    Raises:
        PatternError: If the quiet frames do not cover the pattern.
        ModelError: If there is no such reader, estimator, prior or rule, or it does not go with the skin.
    """
    if mode is None:
        flat = known.model.mesh.nodes.shape[1] == 2
        mode = recorded_mode(known.skin) if flat else replace(RECORDED, reader="centroid")
    sensor = build(mode, known, Fixed(frame.pattern))
    percept = sensor.step(sensor.start(), lambda _: frame)[1]
    belief = percept.belief
    if not belief.detections:
        return percept
    share, left = quiet_confidence(known, frame.pattern), belief.unexplained
    share *= common_confidence(common_change(known, [known.difference(frame)])[1])
    share *= crowd_confidence(len(belief.detections), len(known.skin.electrodes))
    if not isinstance(sensor.reader, DetectionReader):  # whose image is judged by the sensor
        misfit, believed = image_misfit(known, [known.difference(frame)]), fit_confidence(left)
        share *= min(image_confidence(misfit) / believed, 1.0) if believed > 0 else 0.0  # contacts' part is counted
        left = max(misfit, left)
    detections, contacts = (scaled_confidence(some, share) for some in (belief.detections, belief.contacts))
    return replace(percept, belief=replace(belief, detections=detections, contacts=contacts, unexplained=left))


def _rehearse(sensor: Sensor) -> None:
    """Touch a simulated skin, so that what is compiled at first use is compiled before the first contact, not at it."""
    if sensor.locator.fitter is None:
        return
    mesh, state = sensor.known.model.mesh, sensor.start()
    far = (mesh.nodes.min(axis=0) + 3 * mesh.nodes.max(axis=0)) / 4
    contacts = np.array([mesh.centroids.mean(axis=0), far])
    with suppress(DataError, ModelError):
        for count in _REHEARSED:
            state, _ = sensor.step(state, sensor.known.pressed(contacts[:count]))


def _learned(sensor: Sensor, finder: ContactFinder) -> tuple[Thresholds, float]:
    """gamma_0 from quiet frames: their highest values, or predicted noise where frames are too few; and how
    long the images of one take (s)."""
    known = sensor.known
    repeats = known.quiet.repeats
    base, final, state = [], [], sensor.start()
    begin = seconds = np.inf
    for number in range(repeats):
        started = time.monotonic()
        # scans of one frame come from repeats far apart: where both drive a pair, their noise is not the same
        apart, scans = repeats // sensor.drive.scans, range(sensor.drive.scans)
        turns = iter([(number + k * apart) % repeats for k in scans])
        scan = lambda pattern, turns=turns: known.quiet.scan(pattern, next(turns))  # noqa: E731
        state, percept = sensor.step(state, scan)
        image = percept.belief.image  # of what contacts are found in
        base.append(finder.highest(percept.base_estimate.image if percept.base_estimate else image))
        final.append(finder.highest(image))
        seconds = min(seconds, time.monotonic() - started)  # the quickest: the first prepares much
        begin = min(begin, time.thread_time())  # what others on the machine do must not count
        if repeats < _LEAST_QUIET or (number + 1 >= _LEAST_QUIET and time.thread_time() - begin > _PATIENCE):
            break
    if len(base) < _LEAST_QUIET:
        predicted = _SIGMAS * float(percept.image.contrast_std(np.arange(len(percept.image.values))).max())
        return Thresholds(predicted, predicted), seconds
    # the quiet frames' own mean is taken off them; later ones have it
    share = float(np.sqrt((1 + 1 / repeats) / (1 - 1 / repeats)))
    return Thresholds(share * learn_threshold(base), share * learn_threshold(final)), seconds
