"""Conformance check of devices, for authors of drivers and firmware.

Each check is a function that raises `_Failed` with what it saw, or `_Skipped` with why it does not apply; a device
that is lost or raises something else in a check fails it. They take some seconds; nothing should touch the skin
meanwhile.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.device.capabilities import Feature
from ohmskin.device.driver import Device
from ohmskin.errors import DeviceError, DeviceLost, DeviceRefused, OhmskinError, PatternError
from ohmskin.scan import DrivePattern, Frame, FrameFlag, measure_others

_PROMPT = 1.0  # s beyond its timeout within which a scan must have given up
_NOISY = 0.02  # share of the signal by which repeated and reciprocal voltages may differ
_SCANS = 12
_THREADS = 3


@dataclass(frozen=True)
class Check:
    """The outcome of one check.

    Args:
        name: What was checked.
        outcome: "passed", "failed" or "skipped".
        words: What was seen, or why it was skipped; empty where it passed.
    """

    name: str
    outcome: str
    words: str = ""

    def __str__(self) -> str:
        return f"{self.outcome}: {self.name}" + (f": {self.words}" if self.words else "")


class _Failed(Exception):
    """What was seen."""


class _Skipped(Exception):
    """Why a check does not apply."""


def check_device(device: Device, report: Callable[[Check], None] = lambda _: None) -> list[Check]:
    """Check a device; it is closed afterwards.

    Args:
        device: Freshly opened, with an untouched skin.
        report: Called with each outcome as soon as it is there.

    Returns:
        One outcome for each check, in the order they ran.
    """
    checks = []
    for name, work in _CHECKS.items():
        checks.append(_outcome(name, work, device))
        report(checks[-1])
    return checks


def _outcome(name: str, work: Callable[[Device], None], device: Device) -> Check:
    if device.reference and work in _OF_SEVERAL_PATTERNS:
        return Check(name, "skipped", "a recording has one pattern only")
    try:
        work(device)
    except _Failed as failure:
        return Check(name, "failed", str(failure))
    except _Skipped as reason:
        return Check(name, "skipped", str(reason))
    except OhmskinError as error:
        return Check(name, "failed", f"{type(error).__name__}: {error}")
    except Exception as error:  # noqa: BLE001  a driver of someone else's may raise anything; that is a finding
        words = f"raised {type(error).__name__}: {error}; drivers raise DeviceLost, DeviceRefused or ProtocolError"
        return Check(name, "failed", words)
    return Check(name, "passed")


def _need(condition: object, words: str) -> None:
    if not condition:
        raise _Failed(words)


def _scanned(device: Device, pattern: DrivePattern, timeout: float | None = None) -> Frame:
    """A frame, which must be of the pattern asked for."""
    frame = device.scan(pattern, timeout)
    _need(frame.pattern == pattern, "a frame has another pattern than was asked for")
    return frame


def _pattern(device: Device, seed: int = 0) -> DrivePattern:
    """A pattern that the device should take: the recording's own, or some injections with as many voltages as fit."""
    if device.reference:
        return device.reference[0].pattern
    able = device.capabilities
    rng = np.random.default_rng(seed)
    count = min(4, able.max_injections)
    pairs = np.array([rng.choice(able.n_electrodes, 2, replace=False) for _ in range(count)])
    if able.n_electrodes < 4:
        return DrivePattern(pairs, np.column_stack([np.arange(count), pairs]))
    whole = measure_others(pairs, range(able.n_electrodes)).measurements.reshape(count, -1, 3)
    return DrivePattern(pairs, whole[:, : max(1, able.max_measurements // count)].reshape(-1, 3))


def _capabilities(device: Device) -> None:
    able = device.capabilities
    _need(able.name.strip(), "it has no name")
    _need(device.url, "its url is empty")
    if device.reference:
        return
    _need(able.n_electrodes >= 4, f"n_electrodes is {able.n_electrodes}; a skin needs 4 at least")
    _need(able.full_scale > 0, "full_scale is 0 V; give the converter's range")
    _need(able.excitation > 0, "excitation is 0; give the volts (Feature.VOLTAGE_SOURCE) or amperes that drive a pair")
    if Feature.VOLTAGE_SOURCE in able.features:
        _need(Feature.CURRENT_MEASURED in able.features, "a voltage source without measured currents cannot be used")
    longest = able.max_injections * able.settle_time + able.max_measurements * able.conversion_time
    words = f"the largest pattern would take {longest:.0f} s by settle_time and conversion_time; are they in seconds?"
    _need(longest < 600, words)


def _frames(device: Device) -> None:
    pattern = _pattern(device)
    frame = _scanned(device, pattern)
    shape = frame.voltages.shape
    _need(shape == (pattern.n_meas,), f"{shape} voltages for {pattern.n_meas} measurements")
    _need(np.isfinite(frame.currents).all(), f"currents are not finite: {frame.currents}")
    _need((frame.currents > 0).all(), f"currents are not positive: {frame.currents}; a current enters at the source")
    lost = ~np.isfinite(frame.voltages)
    clipped = np.isinf(frame.voltages).any()
    _need(not lost.all(), "no voltage is finite")
    _need(not clipped or FrameFlag.CLIPPED in frame.flags, "voltages are infinite, but FrameFlag.CLIPPED is not set")
    able = device.capabilities
    largest = float(np.abs(frame.voltages[~lost]).max())
    _need(largest > 0, "all voltages are exactly 0")
    if able.full_scale:
        words = f"a voltage of {largest:.3g} V is beyond full_scale, {able.full_scale:.3g} V"
        _need(largest <= 1.01 * able.full_scale, f"{words}; report it as clipped (infinite) instead")
    if able.excitation and Feature.VOLTAGE_SOURCE not in able.features:
        ratio = float(np.median(frame.currents)) / able.excitation
        _need(0.2 < ratio < 5, f"currents are {ratio:.3g} times the stated excitation; give them in amperes")


def _direction(device: Device) -> None:
    pairs = np.array([[0, 1], [1, 0], [0, device.capabilities.n_electrodes - 1]])[: device.capabilities.max_injections]
    frame = _scanned(device, DrivePattern(pairs, np.column_stack([np.arange(len(pairs)), pairs])))
    if not np.isfinite(frame.voltages).any():
        raise _Skipped("no voltage at driven electrodes is known")
    words = f"V(source) - V(sink) is {frame.voltages} V; it must be positive: signs swapped?"
    _need(np.nanmin(frame.voltages) > 0, words)


def _reciprocity(device: Device) -> None:
    n = device.capabilities.n_electrodes
    if n < 4 or device.capabilities.max_injections < 2:
        raise _Skipped("needs four electrodes and two injections in a pattern")
    fours = [(k, (k + 1) % n, (k + n // 2) % n, (k + n // 2 + 1) % n) for k in range(n // 2 - 1)] or [(0, 1, 2, 3)]
    ohms = []
    for a, b, c, d in fours:
        frame = _scanned(device, DrivePattern(np.array([[a, b], [c, d]]), np.array([[0, c, d], [1, a, b]])))
        ohms.append(_ohms(frame))
    there, back = np.array(ohms).T
    off = _off(back, there)
    words = f"R(ab, cd) and R(cd, ab) differ by {100 * off:.2g} %: mixed-up channels, unsettled, or a touched skin"
    _need(off < 5 * _NOISY, words)


def _superposition(device: Device) -> None:
    if device.capabilities.n_electrodes < 5 or device.capabilities.max_injections < 3:
        raise _Skipped("needs five electrodes and three injections in a pattern")
    pattern = DrivePattern(np.array([[0, 1], [1, 2], [0, 2]]), np.array([[0, 3, 4], [1, 3, 4], [2, 3, 4]]))
    frame = _scanned(device, pattern)
    ab, bc, ac = _ohms(frame)
    size = max(abs(ab), abs(bc), abs(ac))
    words = f"R(ab) + R(bc) is {ab + bc:.4g} ohm, R(ac) {ac:.4g} ohm: wrong currents, or not linear"
    _need(abs(ab + bc - ac) < 5 * _NOISY * size, words)


def _repeats(device: Device) -> None:
    pattern = _pattern(device)
    frames = [_scanned(device, pattern) for _ in range(_SCANS)]
    if device.reference:
        return  # a recording may well be of a moving finger
    volts = np.stack([frame.voltages for frame in frames])
    volts = volts[:, np.isfinite(volts).all(axis=0)]
    _need(volts.any(), "no voltage is finite in all of some scans, or all are exactly 0")
    scatter = float(np.sqrt(np.mean(np.var(volts, axis=0)) / np.mean(volts**2)))
    words = f"repeated scans scatter by {100 * scatter:.2g} % of the signal; connect the skin and do not touch it"
    _need(scatter < _NOISY, words)


def _clock(device: Device) -> None:
    pattern = _pattern(device)
    frames = [_scanned(device, pattern) for _ in range(_SCANS)]
    times, numbers = np.array([f.time for f in frames]), np.array([f.sequence for f in frames])
    _need(np.isfinite(times).all(), f"times are not finite: {times}")
    _need((np.diff(times) > 0).all(), f"times do not rise from frame to frame: {times[:4]}")
    _need((np.diff(numbers) > 0).all(), f"sequence numbers do not rise from frame to frame: {numbers[:4]}")
    taken = times[-1] - times[0]
    _need(taken < 600, f"{_SCANS} scans took {taken:.3g} s on the device's clock; is it in seconds?")


def _validation(device: Device) -> None:
    able = device.capabilities
    n = able.n_electrodes
    wrong = {
        f"electrode {n}, which is not there": DrivePattern(np.array([[0, n]]), np.array([[0, 1, 2]])),
        "too many injections": DrivePattern(np.tile([[0, 1]], (able.max_injections + 1, 1)), np.array([[0, 1, 0]])),
        "too many measurements": DrivePattern(np.array([[0, 1]]), np.tile([[0, 1, 0]], (able.max_measurements + 1, 1))),
    }
    for what, pattern in wrong.items():
        with suppress(PatternError):
            device.scan(pattern)
            raise _Failed(f"a pattern with {what} was accepted")
    _scanned(device, _pattern(device))


def _refusals(device: Device) -> None:
    pattern = _pattern(device)
    for number in range(6):
        with suppress(PatternError, DeviceRefused, DeviceError):
            device.scan(pattern, timeout=-1.0)
        with suppress(PatternError, DeviceRefused):
            device.press(number, (math.nan, 0.0), 1e-3, 1.0)
        _scanned(device, pattern)


def _press(device: Device) -> None:
    at = (0.0, 0.0)
    if device.capabilities.virtual:
        device.press(0, at, 1e-3, 0.0)  # lifts what is not there, which harms nothing
        raise _Skipped("virtual: it may be pressed")
    with suppress(DeviceRefused):
        device.press(0, at, 1e-3, 1.0)
        raise _Failed("it is not virtual, yet accepted a press")


def _slots(device: Device) -> None:
    patterns = [_pattern(device, seed) for seed in range(device.capabilities.pattern_slots + 3)]
    first = [_scanned(device, pattern) for pattern in patterns]
    for pattern, before in [*zip(patterns, first, strict=True)][::-1] * 2:
        _same(_scanned(device, pattern), before, "with more patterns than slots")


def _largest(device: Device) -> None:
    able = device.capabilities
    per_injection = max(1, min(able.n_electrodes - 3, able.max_measurements // able.max_injections))
    rng = np.random.default_rng(1)
    pairs = np.array([rng.choice(able.n_electrodes, 2, replace=False) for _ in range(able.max_injections)])
    rows = np.repeat(np.column_stack([np.arange(len(pairs)), pairs]), per_injection, axis=0)
    pattern = DrivePattern(pairs, rows[: able.max_measurements])
    _scanned(device, pattern, timeout=10 + 10 * able.scan_time(pattern))


def _timeout(device: Device) -> None:
    pattern = _pattern(device)
    for timeout in (1e-6, 0.02):
        start = time.monotonic()
        with suppress(DeviceLost):
            device.scan(pattern, timeout=timeout)
        taken = time.monotonic() - start
        most = timeout + _PROMPT + device.capabilities.scan_time(pattern)
        _need(taken < most, f"a scan with timeout {timeout:g} s took {taken:.2f} s")
    _scanned(device, pattern)


def _threads(device: Device) -> None:
    patterns = [_pattern(device, seed) for seed in range(_THREADS)]
    expected = [_scanned(device, pattern) for pattern in patterns]

    def work(pattern: DrivePattern, before: Frame) -> None:
        for _ in range(8):
            frame = _scanned(device, pattern)
            if not device.reference:
                _same(frame, before, "with several threads")

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(work, patterns, expected))


def _same(frame: Frame, before: Frame, when: str) -> None:
    off = _off(frame.voltages, before.voltages)
    words = f"{when}, voltages are off by {100 * off:.2g} % from the first scan of their pattern"
    _need(off < 5 * _NOISY, words)


def _ohms(frame: Frame) -> Floats:
    """Voltages over currents, of one measurement for each injection; NaN where no current flows."""
    flowing = np.where(frame.currents > 0, frame.currents, np.nan)
    return np.asarray(frame.voltages / flowing)


def _off(values: Floats, expected: Floats) -> float:
    """Root mean square error as a share of what was expected, where both are finite."""
    known = np.isfinite(values) & np.isfinite(expected)
    _need(expected[known].any(), "no voltage is finite, or all are exactly 0")
    return float(np.sqrt(np.mean((values[known] - expected[known]) ** 2) / np.mean(expected[known] ** 2)))


def _closing(device: Device) -> None:
    device.close()
    device.close()
    with suppress(DeviceError):
        device.scan(_pattern(device))
        raise _Failed("it can be scanned after it was closed")


_OF_SEVERAL_PATTERNS = (_direction, _reciprocity, _superposition, _slots, _largest)
_CHECKS: dict[str, Callable[[Device], None]] = {
    "capabilities make sense": _capabilities,
    "frames fit their pattern": _frames,
    "current enters at the source": _direction,
    "reciprocity": _reciprocity,
    "superposition": _superposition,
    "repeated scans agree": _repeats,
    "time and sequence rise": _clock,
    "impossible patterns are refused": _validation,
    "refusals leave it usable": _refusals,
    "presses on a real skin are refused": _press,
    "more patterns than slots": _slots,
    "largest pattern": _largest,
    "timeouts are kept": _timeout,
    "several threads": _threads,
    "closing twice": _closing,
}
