"""Calibration of the untouched skin: conductivity, contacts, noise and drift."""

from datetime import UTC, datetime

import numpy as np

from ohmskin.calibrate.measures import check_fit, mean_frame, measure_noise, scan_whole
from ohmskin.calibrate.wiring import diagnose, terminal_pattern
from ohmskin.device import Device
from ohmskin.errors import DataError, DeviceError
from ohmskin.scan import Frame
from ohmskin.skin import Calibration, Skin

_SCANS = 24
_TELLING = 0.02  # share of a typical pair's resistance that the mesh may be off at an electrode


def calibrate_quiet(device: Device, skin: Skin, version: str = "", scans: int = _SCANS) -> Calibration:
    """Measure the untouched skin. Forces come later, see `PressGuide` and `fit_force`.

    Args:
        device: A device that can drive any pattern.
        skin: What it should be; its own calibration, if any, is not used.
        version: Of ohmskin, to be noted down.
        scans: Scans of all pairs, 3 at least. The longer they take, the better is drift told from noise.

    Raises:
        DataError: If an electrode is not in order; the message says which.
        DeviceError: If the device is a recording or has another number of electrodes.
    """
    n_elec = len(skin.electrodes)
    if device.reference:
        raise DeviceError("a recording cannot be calibrated: it has one pattern only")
    check_fit(device, skin)
    if scans < 3:
        raise DataError(f"{scans} scans; drift and noise take 3 at least")
    frames = [scan_whole(device, terminal_pattern(n_elec)) for _ in range(scans)]
    mean = mean_frame(frames)
    diagnosis = diagnose(skin, mean)
    if diagnosis.findings:
        wrong = "; ".join(str(finding) for finding in diagnosis.findings)
        raise DataError(f"the wiring is not in order: {wrong}; mend it, see `ohmskin self-test`, and calibrate again")
    beyond = float(np.median(diagnosis.series))
    told = beyond > _TELLING * float(np.median(diagnosis.pair_resistances))
    noise = measure_noise(frames, list(range(n_elec)), skin)
    return Calibration(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        version=version,
        made_for=skin.digest,
        conductivity=diagnosis.conductivity,
        contact_resistance=beyond if told else 0.0,
        misfit=diagnosis.misfit,
        noise=noise.typical,
        drift=_drift(frames),
        pair_resistances=tuple(float(f"{ohms:.7g}") for ohms in diagnosis.pair_resistances),
    )


def _drift(frames: list[Frame]) -> float:
    """Growth of a voltage's standard deviation with the root of time (V / s^0.5); 0 if it cannot be told from noise."""
    volts = np.stack([frame.voltages for frame in frames])
    times = np.array([frame.time for frame in frames])
    volts = volts[:, np.isfinite(volts).all(axis=0)]
    third = len(frames) // 3
    span = float(times[-third:].mean() - times[:third].mean())
    change = volts[-third:].mean(axis=0) - volts[:third].mean(axis=0)
    noise = (np.diff(volts, axis=0) ** 2).mean(axis=0) / 2 * 2 / third
    excess = change**2 - noise
    if span <= 0 or excess.mean() < 3 * excess.std() / np.sqrt(len(excess)):
        return 0.0
    return float(np.sqrt(excess.mean() / span))
