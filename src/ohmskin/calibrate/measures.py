"""Figures of the instrument: noise, offset, linearity, settling and link, measured on the untouched skin."""

import time
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.calibrate.wiring import potentials
from ohmskin.device import Capabilities, Device, Link
from ohmskin.errors import DeviceError
from ohmskin.scan import DrivePattern, Frame, FrameFlag, adjacent, pair_index
from ohmskin.scan.repeats import known_mean, rms
from ohmskin.sensing import drive_of, mode_named, modes
from ohmskin.skin import Skin

_SWITCHES = 6  # injections between which settling is measured
_STEADY = 3  # scans of an injection without switching, after which it counts as settled
_ROUND_TRIPS = 20
_LONGEST, _SLOWER = 10.0, 0.5  # s that a scan of the rim may take; beside twice what it took, of another device


@dataclass(frozen=True)
class Noise:
    """Scatter of repeated voltages.

    Args:
        typical: Median over the measurements of the standard deviation of one voltage (V).
        worst: Largest standard deviation of the voltages measured at one electrode, rms (V).
        worst_electrode: Which.
        described: What the skin's description says (V).
        current: Standard deviation of a measured current, as a share of it; 0 where currents are nominal.
    """

    typical: float
    worst: float
    worst_electrode: int
    described: float
    current: float


@dataclass(frozen=True)
class Offset:
    """What is left of voltages when the current is reversed: (V+ I- + V- I+) / (I+ + I-).

    Args:
        rms: Root mean square over the measurements (V).
        noise: What of that noise alone would give (V).
        worst: The largest offset of a terminal against their mean (V).
        worst_electrode: Which.
    """

    rms: float
    noise: float
    worst: float
    worst_electrode: int


@dataclass(frozen=True)
class Linearity:
    """How well currents add up: R(ab) + R(bc) - R(ac), which is nothing on any linear sheet.

    Args:
        error: Root mean square, as a share of the signal.
        noise: What of that noise alone would give.
        reciprocity: Root mean square voltage that no resistive network explains, as a share of the signal.
    """

    error: float
    noise: float
    reciprocity: float


@dataclass(frozen=True)
class Settling:
    """How far voltages are from their final value when they are sampled, after a change of injection.

    Args:
        left: Share of the step that is left, least squares over all steps.
        noise: Standard deviation of `left`.
        settle_time: Waiting time of the device (s).
        needed: Waiting time after which less than the noise would be left of the largest step (s); NaN where nothing
            is left to estimate it from, so that the present time is enough.
    """

    left: float
    noise: float
    settle_time: float
    needed: float

    @property
    def settled(self) -> bool:
        """Whether what is left cannot be distinguished from noise, or is a thousandth at most."""
        return abs(self.left) < max(3 * self.noise, 1e-3)


@dataclass(frozen=True)
class LinkBudget:
    """Time and bytes of the link between host and device.

    Args:
        round_trip: Median time of the smallest scan beyond the device's own time (s).
        worst_round_trip: The longest seen (s).
        scan_time: Median time of the base scan, as the host sees it (s).
        own_time: What the device needs for it by its own account (s).
        bytes_per_scan: Bytes both ways for it; 0 where the driver does not count them.
        retries: Requests sent again while all this was measured.
    """

    round_trip: float
    worst_round_trip: float
    scan_time: float
    own_time: float
    bytes_per_scan: float
    retries: int


@dataclass(frozen=True)
class Rates:
    """Scans and cycles per second with this wiring.

    Args:
        base: Base scans per second as measured.
        cycles: Cycles per second by mode, from what was measured; the host's own work, if slower, is on top.
        settle_time: Waiting time proposed for each injection (s).
        proposed: Cycles per second by mode with the proposed waiting time.
    """

    base: float
    cycles: dict[str, float]
    settle_time: float
    proposed: dict[str, float]


def check_fit(device: Device, skin: Skin, before: Capabilities | None = None) -> None:
    """Raise DeviceError unless a device has as many electrodes as a skin, and scans its rim within seconds.

    One that takes the place of another must be about as quick as that was, or the loop would wait for it.
    """
    found, wanted = device.capabilities.n_electrodes, len(skin.electrodes)
    if found != wanted:
        raise DeviceError(f"the device has {found} electrodes, skin {skin.name!r} has {wanted}; choose one that fits")
    rim = adjacent(skin.electrodes.rings[:1])
    most = _LONGEST if before is None else min(_LONGEST, 2 * before.scan_time(rim) + _SLOWER)
    if (takes := device.capabilities.scan_time(rim)) > most:
        told = f"by its settle_time and conversion_time the device takes {takes:.3g} s to scan the rim"
        raise DeviceError(f"{told}; allowed are {most:.2g} s: are they in seconds?")


def scan_whole(device: Device, pattern: DrivePattern) -> Frame:
    """One scan of a pattern of any size, piece by piece where the device takes no more at a time."""
    able = device.capabilities
    frames = [device.scan(piece) for piece in pattern.split(able.max_injections, able.max_measurements)]
    flags = FrameFlag(0)
    for frame in frames:
        flags |= frame.flags
    volts, currents = np.concatenate([f.voltages for f in frames]), np.concatenate([f.currents for f in frames])
    last = frames[-1]
    return Frame(pattern, volts, currents, last.time, last.sequence, flags, auxiliary=last.auxiliary)


def mean_frame(frames: list[Frame]) -> Frame:
    """The mean of scans of one pattern; a value that is mostly missing or clipped stays so."""
    volts = np.stack([frame.voltages for frame in frames])
    mean = np.where(np.isfinite(volts).mean(axis=0) > 0.5, known_mean(volts), np.nan)
    currents = np.mean([frame.currents for frame in frames], axis=0)
    return Frame(frames[0].pattern, mean, currents, frames[-1].time, frames[-1].sequence, frames[-1].flags)


def measure_noise(frames: list[Frame], alive: list[int], skin: Skin) -> Noise:
    """From repeated scans (at least two); differences of successive ones, so that slow drift is no noise."""
    pattern = frames[0].pattern
    volts = np.stack([frame.voltages for frame in frames])
    usable = np.flatnonzero(np.isin(pattern.quadruples, alive).all(axis=1) & np.isfinite(volts).all(axis=0))
    squares = np.mean(np.diff(volts[:, usable], axis=0) ** 2, axis=0) / 2
    n_elec = len(skin.electrodes)
    plus = pattern.measurements[usable, 1]
    sums, counts = np.bincount(plus, squares, n_elec), np.bincount(plus, minlength=n_elec)
    by_electrode = np.sqrt(sums / np.maximum(counts, 1))
    worst = int(np.argmax(by_electrode))
    amperes = np.stack([frame.currents for frame in frames])[:, np.isin(pattern.injections, alive).all(axis=1)]
    share = float(np.sqrt(np.mean(np.diff(amperes, axis=0) ** 2) / 2) / np.mean(amperes))
    return Noise(float(np.sqrt(np.median(squares))), float(by_electrode[worst]), worst, skin.converter.noise, share)


def _against_last(injections: Ints, alive: list[int]) -> DrivePattern:
    """Drives `injections` (n, 2), and measures all other electrodes in order against the last of these."""
    others = [[e for e in alive if e not in pair] for pair in injections.tolist()]
    return DrivePattern(injections, np.array([(k, e, rest[-1]) for k, rest in enumerate(others) for e in rest[:-1]]))


def measure_offset(device: Device, noise: Noise, alive: list[int], repeats: int = 8) -> Offset:
    """Drive neighbours both ways and see what does not turn with the current."""
    pairs = np.column_stack([alive, np.roll(alive, -1)])
    pattern = _against_last(np.stack([pairs, pairs[:, ::-1]], axis=1).reshape(-1, 2), alive)
    frame = mean_frame([scan_whole(device, pattern) for _ in range(repeats)])
    volts, amperes = frame.voltages.reshape(len(pairs), 2, -1), frame.currents.reshape(len(pairs), 2, 1)
    offsets = (volts[:, 0] * amperes[:, 1] + volts[:, 1] * amperes[:, 0]) / amperes.sum(axis=1)
    # each is the plus terminal's less the minus terminal's
    _, plus, minus = pattern.measurements[pattern.measurements[:, 0] % 2 == 0].T
    terminal = np.eye(device.capabilities.n_electrodes)
    design = np.vstack([terminal[plus] - terminal[minus], np.ones(len(terminal))])
    values = np.append(np.nan_to_num(offsets.ravel()), 0.0)
    own = np.linalg.lstsq(design, values, rcond=None)[0]
    worst = int(np.argmax(np.abs(own)))
    current_noise = noise.current * float(np.nanstd(volts)) / np.sqrt(2)
    expected = float(np.hypot(noise.typical / np.sqrt(2), current_noise)) / np.sqrt(repeats)
    return Offset(float(np.sqrt(np.nanmean(offsets**2))), expected, float(own[worst]), worst)


def measure_linearity(frame: Frame, repeats: int, noise: Noise, alive: list[int], contradiction: float) -> Linearity:
    """From a mean scan of all pairs against the sink: loops of three injections seen between two other electrodes."""
    n_elec = int(frame.pattern.quadruples.max()) + 1
    # useless pairs are not looked at
    ohms = potentials(frame, n_elec) / np.where(frame.currents > 0, frame.currents, np.inf)[:, None]
    *three, d, e = (np.roll(alive, -k) for k in range(5))  # each (n_alive,)
    a, b, c = np.sort(three, axis=0)
    pairs = pair_index([a, b, a], [b, c, c], n_elec)
    seen = ohms[pairs, d] - ohms[pairs, e]
    own = np.hypot(np.sqrt(2) * noise.typical / frame.currents[pairs], seen * noise.current)
    signal, error = rms(seen[2]), rms(seen[0] + seen[1] - seen[2])
    expected = rms(np.sqrt(np.sum(own**2, axis=0) / repeats))
    return Linearity(error / signal, expected / signal, contradiction)


def measure_settling(device: Device, noise: Noise, alive: list[int], repeats: int = 12) -> Settling:
    """Inject at two far pairs in turn, each several times: the first sample after a change against the last one."""
    half = len(alive) // 2
    pairs = [(alive[k], alive[(k + half) % len(alive)]) for k in range(min(_SWITCHES, half))]
    injections = np.repeat([pair for one in pairs for pair in (one, one[::-1])], 1 + _STEADY, axis=0)
    pattern = _against_last(injections, alive)
    frames = [scan_whole(device, pattern) for _ in range(repeats)]
    able = device.capabilities
    per_piece = min(able.max_injections, able.max_measurements // (len(alive) - 3))
    blocks = mean_frame(frames).voltages.reshape(-1, 1 + _STEADY, len(alive) - 3)  # of one injection each
    final, number = blocks[:, 1:].mean(axis=1), np.arange(1, len(blocks))
    first = (1 + _STEADY) * number
    # what went before must be of the same scan, and measured at the same electrodes: those of a pair's other direction
    told = number[(first // per_piece == (first - 1) // per_piece) & (number % 2 == 1)]
    step, left = (blocks[told - 1, -1] - final[told]).ravel(), (blocks[told, 0] - final[told]).ravel()
    known = np.isfinite(step) & np.isfinite(left)
    energy = max(float(step[known] @ step[known]), 1e-30)
    share = float(step[known] @ left[known]) / energy
    spread = np.sqrt(2) * noise.typical * np.sqrt((1 + 1 / _STEADY) / repeats / energy)
    wait, swing = able.settle_time, float(np.abs(step[known]).max(initial=0.0))
    needed = float("nan")
    if share > max(3 * spread, 1e-9) and share < 1 and swing > noise.typical:
        needed = wait * float(np.log(swing / noise.typical) / np.log(1 / share))
    return Settling(share, float(spread), wait, needed)


def measure_link(device: Device, base: DrivePattern, alive: list[int]) -> LinkBudget:
    """Time small and whole scans, and count their bytes where the driver does."""
    a, b, c, d = alive[:4]
    smallest = DrivePattern(np.array([[a, b]]), np.array([[0, c, d]]))
    link: Link | None = getattr(device, "link", None)
    retries = device.dropped

    def times(pattern: DrivePattern) -> Floats:
        scan_whole(device, pattern)  # gives it to the device
        taken = []
        for _ in range(_ROUND_TRIPS):
            start = time.monotonic()
            scan_whole(device, pattern)
            taken.append(time.monotonic() - start)
        return np.array(taken)

    beyond = np.maximum(times(smallest) - device.capabilities.scan_time(smallest), 0.0)
    scan_whole(device, base)
    before = (link.bytes_in + link.bytes_out) if link else 0
    whole = times(base)
    moved = ((link.bytes_in + link.bytes_out) - before) / (_ROUND_TRIPS + 1) if link else 0.0
    own, again = device.capabilities.scan_time(base), device.dropped - retries
    return LinkBudget(float(np.median(beyond)), float(beyond.max()), float(np.median(whole)), own, moved, again)


def propose_rates(device: Device, skin: Skin, link: LinkBudget, settling: Settling) -> Rates:
    """Cycles per second of each mode now, and with a waiting time that settles to below the noise."""
    able = device.capabilities
    # a scan takes a round trip, the waiting of its injections, and the rest by measurements: conversion, line, host
    base = drive_of(mode_named(skin, ""), skin).next((), 0)
    per_measurement = max(link.scan_time - link.round_trip - base.n_inj * able.settle_time, 0.0) / base.n_meas
    wait = settling.needed if settling.needed > able.settle_time and not settling.settled else able.settle_time

    def cycle(scans: list[tuple[int, int]], settle: float) -> float:
        each = [i * settle + m * per_measurement + link.round_trip for i, m in scans]
        return 1 / max(sum(each), 1e-9)

    cycles, proposed = {}, {}
    for name, mode in modes(skin).items():
        drive = drive_of(mode, skin)
        first, complete = drive.next((), 0), drive.patterns[-1]
        scans = [(first.n_inj, first.n_meas)]
        if left := drive.injections - first.n_inj:
            scans.append((left, round(left * complete.n_meas / complete.n_inj)))
        cycles[name], proposed[name] = cycle(scans, able.settle_time), cycle(scans, wait)
    return Rates(1 / link.scan_time, cycles, wait, proposed)
