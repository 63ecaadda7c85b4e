"""``ohmskin calibrate``: the quiet skin, its sheet and contacts, and newtons."""

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

import ohmskin
from ohmskin.calibrate import (
    GRAVITY,
    ForceSampler,
    LoadCell,
    PressGuide,
    PressStep,
    calibrate_quiet,
    fit_newtons,
    press_plan,
    read_table,
)
from ohmskin.cli.heartbeat import HEARTBEAT
from ohmskin.cli.options import Numbers, SkinName, check_picture, check_writable, open_skin, say, watched, write_skin
from ohmskin.device import Device
from ohmskin.engine import Engine, Touch
from ohmskin.errors import DataError, DeviceError, OhmskinError
from ohmskin.inverse.quality import wrong_units
from ohmskin.outlets.load_cell import open_load_cell
from ohmskin.recording.player import reimage
from ohmskin.sensing import SkinModel, mode_named
from ohmskin.skin import Calibration, Press, Skin

_TIP = 8e-3  # m, radius of the virtual finger
_IDLE = 30_000  # cycles without a steady press, some minutes, after which we give up
_WEIGHTS, _PLACES = (100.0, 200.0, 400.0, 700.0, 1000.0), 5  # g, unless given
_TOPIC, _SAMPLES = "/wrench", 10  # likewise
_GAP = 1.0  # s between rows of a table of forces, and over five times the usual, within which no force is known
_SILENT, _SAME = 5.0, 3  # s of pressing without a force, and presses of one and the same, from which on we give up
_BETWEEN = 0.2  # s without a contact between two presses
_PATIENCE = 200  # cycles without a result, such as while the device is lost, after which we give up


def calibrate(
    *,
    device: str = "virtual:",
    skin: SkinName = "",
    output: Path | None = None,
    picture: Path | None = None,
    mode: str = "",
    weights: Numbers = _WEIGHTS,
    places: int = _PLACES,
    presses: Path | None = None,
    force_from: str = "",
    force_topic: str = _TOPIC,
    samples: int = _SAMPLES,
    force: bool = True,
) -> None:
    """Calibrate a skin and write its calibrated description. A virtual skin is pressed by the program.

    Newtons come from weights on a small foot, from known presses, or, with --force-from, from another instrument's
    force readings while you press anywhere.

    Args:
        device: Address: virtual:, tcp://HOST:PORT, serial://PORT.
        output: File for the calibrated skin; NAME-calibrated.toml unless given. One that is there is kept under
            another name.
        picture: Also save the fitted sheet and the force curve as a picture, such as calibration.png.
        mode: Drive mode to calibrate; the default mode unless given.
        weights: Weights to place (g), all on the same small foot.
        places: Number of places to press.
        presses: Presses to make instead, in that order: a .csv file with columns x_mm, y_mm and force_N.
        force_from: Source of the forces: serial://PORT (for example with ?baud=9600; lines that end with newtons),
            zenoh[:PLACE] or dds[:INTERFACE] (a WrenchStamped of ROS 2); or, with --device replay:FILE, a .csv file with
            columns time_s (from the first frame after the calibration) and force_N.
        force_topic: With zenoh and dds, the topic.
        samples: With --force-from, number of steady presses.
        force: Whether to calibrate newtons, too; --no-force measures the quiet skin only.
    """
    if picture is not None:
        check_picture(picture)
    if not 2 <= samples <= 1000:
        raise OhmskinError(f"--samples is {samples}; choose 2 to 1000")
    source = "--no-force" if not force else "--force-from" if force_from else "--presses" if presses else "--weights"
    for name, given, needed in (
        ("--force-from", force_from, "--force-from"),
        ("--force-topic", force_topic != _TOPIC, "--force-from"),
        ("--samples", samples != _SAMPLES, "--force-from"),
        ("--samples", samples != _SAMPLES and device.startswith("replay:"), "a device"),
        ("--presses", presses, "--presses"),
        ("--weights", tuple(weights) != _WEIGHTS, "--weights"),
        ("--places", places != _PLACES, "--weights"),
    ):
        if given and source != needed:
            instead = "forces come from weights" if source == "--weights" else f"{source} is given"
            raise OhmskinError(f"{name} has no effect where {instead}; leave it out")
    console = Console(highlight=False, soft_wrap=True)
    opened, description = open_skin(device, skin)
    path = output or Path(f"{description.name}-calibrated.toml")
    curve, sampler = None, ForceSampler(samples)
    guide: PressGuide | ForceSampler = sampler
    failed: OhmskinError | None = None
    with ExitStack() as stack:
        stack.enter_context(opened)
        check_writable(path)  # now, rather than after an hour of presses
        mode_named(description, mode)
        cell = LoadCell()
        if force_from and not device.startswith("replay:"):
            stack.callback(open_load_cell(force_from, force_topic, cell.update, cell.fail))  # likewise
        if device.startswith("replay:"):
            known, mode = _replayed(device.removeprefix("replay:"), force_from, sampler, mode, skin)
            calibrated, found = description, description.calibration.made_now(description.digest, ohmskin.__version__)
        else:
            description = replace(description, calibration=Calibration())
            plan = () if force_from or not force else _plan(description, presses, weights, places)
            found = _quiet(opened, description, console)
            calibrated, known = replace(description, calibration=found), None
            if force:
                with Engine(lambda: opened, calibrated, mode) as engine:
                    console.print(f"calibrating mode {engine.mode.name}")
                    engine.calibrate()
                    if not engine.device.capabilities.virtual:
                        HEARTBEAT.end()  # it waits for presses
                    try:
                        if force_from:
                            _listen(engine, sampler, cell, force_from)
                        else:
                            guide = asked = PressGuide(plan)
                            _run_plan(engine, asked, calibrated)
                    except DeviceError as error:  # what was measured so far is kept
                        failed = error
                    known, mode = engine.known, engine.mode.name
        if known is not None:
            try:
                found, curve, words = fit_newtons(replace(found, mode=mode), guide, known)
                for sentence in words:
                    console.print(sentence)
            except DataError as error:
                if device.startswith("replay:"):
                    raise
                failed = failed or error
    write_skin(path, replace(description, calibration=found))
    console.print(f"wrote {path}; use it with --skin {path}")
    if picture is not None:
        from ohmskin.plot.calibration import save_calibration  # here: it needs the extra `plot`

        save_calibration(picture, calibrated, guide.samples, curve)
    if failed:
        has = f"newtons by the {len(guide.samples)} presses so far" if curve else "the quiet skin alone, no newtons"
        raise type(failed)(f"{failed}. {path} has {has}; run the command again for all")


def _quiet(opened: Device, description: Skin, console: Console) -> Calibration:
    """What is measured of the untouched skin."""
    console.print("measuring the quiet skin; keep it untouched")
    found = calibrate_quiet(opened, description, ohmskin.__version__, report=console.print)
    if ohms := found.contact_impedances:
        contacts = f"contacts about {np.median(ohms):.2g} ohm"
    else:
        contacts = f"contacts {found.contact_resistance:.2g} ohm more than described"
    console.print(f"sheet {1e3 * found.conductivity:.4g} mS per square; {contacts}")
    for sentence in wrong_units(found.conductivity / description.sheet.conductivity):
        console.print(f"[bold]{sentence}[/bold]")
    console.print(f"noise {1e6 * found.noise:.3g} uV, drift {1e6 * found.drift:.3g} uV per root of a second")
    return found


def _plan(skin: Skin, table: Path | None, weights: Sequence[float], places: int) -> tuple[PressStep, ...]:
    """The presses to make."""
    if table is None:
        return press_plan(skin, [GRAVITY * grams * 1e-3 for grams in weights], places)
    steps: list[PressStep] = []
    for x, y, force in read_table(table, ("x_mm", "y_mm", "force_N")).tolist():
        at = (1e-3 * x, 1e-3 * y)
        if not force > 0 or skin.domain.depth([at])[0] <= 0:
            raise OhmskinError(f"{table}: {force:g} N at x {x:g} mm, y {y:g} mm is not a valid press on this skin")
        steps.append(PressStep(at, force, not (steps and steps[-1].at == at and force < steps[-1].force)))
    return tuple(steps)


def _replayed(file: str, force_from: str, sampler: ForceSampler, mode: str, skin: str) -> tuple[SkinModel, str]:
    """Samples of a recording, with the forces of a table; what was known of its quiet skin, and its mode."""
    if not force_from.endswith(".csv"):
        raise OhmskinError("a recording has no forces; give them with --force-from FILE.csv (time_s, force_N)")
    times, forces = read_table(Path(force_from), ("time_s", "force_N")).T
    if (fallen := np.flatnonzero(np.diff(times) <= 0)).size:
        row = int(fallen[0]) + 2
        raise OhmskinError(
            f"{force_from}: row {row} is at {times[row - 1]:g} s, not after the row before; sort the rows"
        )
    steps = np.diff(times)
    gaps = steps > max(_GAP, 5 * float(np.median(steps))) if len(steps) else steps > 0
    if gaps.any():
        say(f"note: no force is known within gaps of {force_from}, which are up to {steps.max():.3g} s long")
    known, last = None, 0.0
    for cycle in watched(reimage(file, mode=mode, skin=skin)):
        known, mode, last = cycle.known, cycle.touch.mode.name, cycle.time
        scans = tuple(map(known.difference, cycle.touch.percept.frames))
        beside = cycle.touch.percept.frames[-1].auxiliary
        force = abs(float(np.interp(cycle.time, times, forces, left=np.nan, right=np.nan)))
        if gaps.any() and gaps[np.clip(np.searchsorted(times, cycle.time) - 1, 0, len(gaps) - 1)]:
            force = np.nan
        sampler.add(cycle.touch.contacts, scans, force, np.nan if beside is None else beside)
    if known is None:
        raise OhmskinError(f"{file} has no frame after its calibration")
    if times[0] > last or times[-1] < 0:
        span = f"{force_from} has forces from {times[0]:g} to {times[-1]:g} s, {file} frames from 0 to {last:g} s"
        raise OhmskinError(f"{span} after its calibration; no force belongs to a frame")
    return known, mode


def _listen(engine: Engine, sampler: ForceSampler, cell: LoadCell, source: str) -> None:
    """Take samples while somebody presses, until there are enough."""
    say(f"press anywhere with the load cell, one finger at a time, {sampler.count} times; hold each for a moment")
    idle, watch = 0, _Watch(sampler, cell, source)
    while not sampler.done:
        touch = engine.step()
        idle += 1
        watch.check(touch)
        if touch is None or (known := engine.known) is None:
            continue
        scans = tuple(map(known.difference, touch.percept.frames))
        beside = touch.percept.frames[-1].auxiliary
        if sampler.add(touch.contacts, scans, cell.force, np.nan if beside is None else beside):
            one, idle = sampler.samples[-1], 0
            x, y = one.at
            place = f"{one.force:.2f} N at x {1e3 * x:.0f} mm, y {1e3 * y:.0f} mm"
            say(f"    [{len(sampler.samples)} of {sampler.count}] {place}: strength {1e6 * one.strength:.3g} mm2")
        elif idle > _IDLE:
            why = "no force was received" if np.isnan(cell.force) else "no steady press was detected"
            raise DeviceError(f"{why} in {_IDLE} cycles; the newest force from {source} is {cell.force:.3g} N")


class _Watch:
    """Tells at once that a load cell gives no forces, or the same one whatever presses, rather than after minutes."""

    def __init__(self, sampler: ForceSampler, cell: LoadCell, source: str) -> None:
        self._sampler, self._cell, self._source = sampler, cell, source
        self._force, self._kept, self._presses = float("nan"), 0, 0  # the last one, and what came since it changed
        self._time, self._free, self._without = time.monotonic(), _BETWEEN, 0.0  # s without a contact, and a force

    def check(self, touch: Touch | None) -> None:
        """Look at a cycle.

        Raises:
            DeviceError: If the cell is lost, or presses have no force, or always the same.
        """
        now = time.monotonic()
        elapsed, self._time = now - self._time, now
        if self._cell.lost:
            raise DeviceError(f"the load cell at {self._source} was lost: {self._cell.lost}; check its plug")
        pressed, force = bool(touch and touch.contacts), self._cell.force
        if not np.isnan(force):
            self._without = 0.0
            if force != self._force:
                self._force, self._kept, self._presses = force, len(self._sampler.samples), 0
            self._presses += pressed and self._free >= _BETWEEN
        elif pressed:
            self._without += elapsed
        self._free = 0.0 if pressed else self._free + elapsed
        if self._without > _SILENT:
            why = self._cell.trouble or "nothing comes; check its wire, whether it is on, and the rate (?baud=)"
            raise DeviceError(f"{self._source} gave no force for {_SILENT:g} s of pressing: {why}")
        if self._presses > _SAME:
            del self._sampler.samples[self._kept :], self._sampler.peaks[self._kept :]  # whose force nobody knows
            told = f"{self._source} told {force:.3g} N, unchanged, for {self._presses} presses and between them"
            raise DeviceError(f"{told}; check its wire, and press with the load cell")


def _run_plan(engine: Engine, guide: PressGuide, skin: Skin) -> None:
    """Press, or have someone press, all that the guide asks for."""
    virtual = engine.device.capabilities.virtual
    while (step := guide.step) is not None:
        words = f"[{len(guide.samples) + 1} of {len(guide.plan)}] {step}"
        say(words if virtual else f"{words}, then press Enter")
        if virtual:
            _press(engine, step, skin)
        elif not sys.stdin.readline():
            why = "standard input ended before all presses were made"
            raise DeviceError(f"{why}; run it on a terminal, or with --no-force")
        guide.begin()
        for _ in range(_PATIENCE):
            touch = engine.step()
            if touch is not None and (known := engine.known) is not None:
                scans = tuple(map(known.difference, touch.percept.frames))
                beside = touch.percept.frames[-1].auxiliary
                if guide.add(touch.contacts, scans, np.nan if beside is None else beside):
                    break
        else:
            raise DeviceError(f"no result in {_PATIENCE} cycles: {engine.message or 'the loop is paused'}")
        strength = guide.samples[-1].strength
        say(f"    strength {1e6 * strength:.3g} mm2" if strength else "    not detected: it is not used")
    if virtual:
        engine.press(0, guide.plan[-1].at, _TIP, 0.0)


def _press(engine: Engine, step: PressStep, skin: Skin) -> None:
    """The pressure that makes this force under the foam of the description."""
    per_pascal = Press(step.at, _TIP, 1.0).force(skin.contact_layer.foam_spread)
    engine.press(0, step.at, _TIP, step.force / per_pascal)
