"""Calibration of the untouched skin: electrodes, sheet, contacts, noise and drift."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.calibrate.measures import check_fit, mean_frame, measure_noise, scan_whole
from ohmskin.calibrate.sheet import SheetFit, fit_sheet
from ohmskin.calibrate.wiring import diagnose, potentials, terminal_pattern
from ohmskin.device import Device
from ohmskin.drive import complete_pattern
from ohmskin.drive.patterns import MOST_WHOLE
from ohmskin.errors import LINK_ERRORS, DataError, DeviceError, ModelError, OhmskinError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Electrodes
from ohmskin.inverse import match_model
from ohmskin.scan import Frame
from ohmskin.scan.pairs import in_series
from ohmskin.scan.repeats import rms
from ohmskin.sensing.identity import UNLIKE
from ohmskin.skin import Calibration, Skin

_SCANS = 24
_TELLING = 0.02  # share of a typical pair's resistance that the mesh may be off at an electrode
_FEW = 8  # scans, while a user waits
_EXPLAINED, _RELATIVE = 5e-4, 0.01  # share of quiet voltages that is left, at most, or of that before: a touch is
# explained the worse by electrodes and waves, and contacts are then located the worse for the fit
_FINE = 0.25  # of the estimator's edges: a mesh on which a driven electrode's resistance is right to 0.3 %


def calibrate_quiet(
    device: Device,
    skin: Skin,
    version: str = "",
    scans: int = _SCANS,
    report: Callable[[str], None] = lambda sentence: None,
) -> Calibration:
    """Measure the untouched skin. Forces are calibrated afterwards, see `PressGuide` and `fit_force`.

    Args:
        device: A device that can drive any pattern.
        skin: Its description; a calibration in it is not used.
        version: Of ohmskin, to be stored.
        scans: Scans of all pairs, 3 at least. The longer they take, the better drift is separated from noise.
        report: Called with what was found, and with a sentence if electrodes and sheet cannot be estimated and stay
            as described.

    Raises:
        DataError: If an electrode is faulty; the message says which.
        DeviceError: If the device is a recording or has another number of electrodes.
    """
    calibration, fit = _measured(device, skin, version, scans)
    report(_words(fit))
    return calibration


def _measured(device: Device, skin: Skin, version: str, scans: int) -> tuple[Calibration, SheetFit | DataError]:
    """The calibration, and the fit of electrodes and sheet or why there is none."""
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
        raise DataError(f"the wiring is faulty: {wrong}; repair it, see `ohmskin self-test`, and calibrate again")
    beyond = float(np.median(diagnosis.series))
    told = beyond > _TELLING * float(np.median(diagnosis.pair_resistances))
    noise = measure_noise(frames, list(range(n_elec)), skin)
    found = Calibration(
        conductivity=diagnosis.conductivity,
        contact_resistance=beyond if told else 0.0,
        misfit=diagnosis.misfit,
        noise=noise.typical,
        drift=_drift(frames),
        pair_resistances=_rounded(diagnosis.pair_resistances),
    ).made_now(skin.digest, version)
    try:
        deviations = noise.typical / np.sqrt(scans), noise.current / np.sqrt(scans)
        fitted, fit = self_calibrated(replace(skin, calibration=found), mean, *deviations)
    except DataError as error:
        return found, error
    return fitted.calibration, fit


def _words(fit: SheetFit | DataError) -> str:
    """What a fit found, or why there is none, in a sentence."""
    if isinstance(fit, DataError):
        return f"the described electrodes and sheet are kept: {fit}"
    worst = int(np.argmax(fit.moved))
    apart = f"{1e3 * fit.moved.mean():.2g} mm on average, electrode {worst} by {1e3 * fit.moved[worst]:.2g} mm"
    left = f"{100 * fit.before:.2g} % of the quiet voltages unexplained before, {100 * fit.after:.2g} % now"
    return f"electrodes are off by {apart}, the sheet is uneven by {100 * fit.uneven:.2g} %: {left}"


def skin_as_measured(
    device: Device,
    skin: Skin,
    version: str = "",
    report: Callable[[str], None] = lambda sentence: None,
    begins: Callable[[str], None] = lambda sentence: None,
) -> Skin:
    """The skin, self-calibrated if its untouched voltages are unlike those of its description.

    One that was calibrated, or learned from presses, is returned as it is, and so is one of many electrodes, or whose
    device scans some patterns only. Something may touch the skin nevertheless, which electrodes and sheet can take for
    theirs in part: a fit that leaves as much unexplained is not used.

    Args:
        device: A device; nothing touches its skin.
        skin: Its description.
        version: As for `calibrate_quiet`.
        report: Called with what was found.
        begins: Called before electrodes and sheet are estimated, which takes some seconds.
    """
    recorded = device.reference or device.url.startswith("replay:")
    if recorded or skin.calibration != Calibration() or len(skin.electrodes) > MOST_WHOLE:
        return skin
    try:
        one, other = (scan_whole(device, complete_pattern(skin.electrodes)) for _ in range(2))
        match = match_model(skin.transfer_model(), mean_frame([one, other]))
        with np.errstate(divide="ignore", invalid="ignore"):  # an open electrode carries no current
            apart = one.voltages - other.voltages * one.measurement_currents / other.measurement_currents
        noise = rms(apart) / 2 / match.signal  # of their mean
        unlike = float(np.sqrt(max(match.misfit**2 - noise**2, 0.0)))
        if unlike < UNLIKE:
            return skin
        begins(
            f"the quiet voltages are {100 * unlike:.2g} % unlike the description: estimating electrodes and "
            "sheet for now; `ohmskin calibrate` keeps them"
        )
        calibration, fit = _measured(device, skin, version, _FEW)
    except (ModelError, *LINK_ERRORS):  # a surface without a map; the loop connects anew
        return skin
    except OhmskinError as error:
        report(f"electrodes and sheet are taken as described: {error}")
        return skin
    if isinstance(fit, SheetFit) and fit.left > max(_EXPLAINED, _RELATIVE * fit.before):
        report(
            f"electrodes and sheet are taken as described: fitted ones leave {100 * fit.left:.2g} % of the quiet "
            "voltages unexplained, as a touch does, or a sheet uneven in finer waves; lift whatever touches the skin "
            "and start again, or run `ohmskin calibrate`"
        )
        return skin
    report(_words(fit))
    return replace(skin, calibration=calibration) if isinstance(fit, SheetFit) else skin


def self_calibrated(skin: Skin, frame: Frame, noise: float, gain: float) -> tuple[Skin, SheetFit]:
    """The skin with its electrodes where they are, its sheet as uneven as it is, and its contacts as they are.

    At corners a contact impedance cannot be distinguished from the sheet about it: no four-terminal resistance
    depends on either.

    Args:
        skin: With conductivity and pair resistances of its calibration.
        frame: A quiet scan of `terminal_pattern`, best a mean of several.
        noise: Standard deviation of its voltages (V).
        gain: Standard deviation of the relative error of its currents (1).

    Raises:
        DataError: If no such skin explains the scan.
    """
    calibration, described = skin.calibration, skin.electrode.on(skin.chart)

    def with_sheet(electrodes: Electrodes, log_conductivity: Floats) -> Skin:
        places = tuple((float(x), float(y)) for x, y in electrodes.positions)
        waves = log_conductivity - log_conductivity[0] * (np.arange(len(log_conductivity)) == 0)
        level = calibration.conductivity * float(np.exp(log_conductivity[0]))
        found = replace(calibration, positions=places, log_conductivity=_rounded(waves), conductivity=level)
        return replace(skin, calibration=found)

    def build(electrodes: Electrodes, log_conductivity: Floats) -> TransferModel:
        return with_sheet(electrodes, log_conductivity).electrode_model()

    pattern = complete_pattern(described)  # with the injections of the frame
    which, plus, minus = pattern.measurements.T
    volts, currents = potentials(frame, len(described)), frame.currents[which]
    resistances = (volts[which, plus] - volts[which, minus]) / currents
    scatter = np.hypot(np.sqrt(2) * noise / currents, gain * resistances)
    fit = fit_sheet(skin.domain, described, build, pattern, resistances, scatter)
    found = with_sheet(fit.model.electrodes, fit.log_conductivity)
    mesh = found.mesh_for(found.discs, _FINE * skin.imaging.mesh_size)
    fine = TransferModel(mesh, found.discs, found.conductivity_on(mesh))
    beyond = calibration.pair_resistances - fine.pair_resistances
    series = np.linalg.lstsq(in_series(range(len(described)), len(described)), beyond, rcond=None)[0]
    impedances = series + fine.electrodes.contact_impedances / fine.electrode_extents
    contacts, unexplained = _rounded(np.maximum(impedances, 0.0)), _rounded(np.array([fit.before, fit.after]))
    told = replace(found.calibration, contact_impedances=contacts, unexplained=unexplained)
    return replace(skin, calibration=told), fit


def _rounded(values: Floats) -> tuple[float, ...]:
    """Numbers as they are written down."""
    return tuple(float(f"{value:.7g}") for value in values)


def _drift(frames: list[Frame]) -> float:
    """Growth of a voltage's standard deviation with the root of time (V / s^0.5); 0 if it is lost in noise."""
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
