"""Whether the untouched skin is the one that was calibrated, learned or described: its quiet voltages tell."""

import numpy as np

from ohmskin.inverse.quality import wrong_units
from ohmskin.sensing.confidence import quiet_match
from ohmskin.sensing.model import SkinModel

_LEAST, _TIMES = 0.02, 5.0  # share by which they differ at least, and over what was left then, or over the noise


def changed_since(known: SkinModel) -> list[str]:
    """What to say where the quiet voltages of `known` are not those of the skin as it was calibrated or learned, or as
    it is described.

    The conductivity as a whole, and the contacts of electrodes, may have changed: voltages of idle electrodes are
    compared, at the best common factor.
    """
    calibration, patterns = known.skin.calibration, known.quiet.patterns
    idle = ~np.concatenate([pattern.driven for pattern in patterns])
    now = np.concatenate([known.baseline.reference(pattern) for pattern in patterns])
    if calibration.channel_resistances:
        then, made = np.concatenate([calibration.resting(pattern) for pattern in patterns]), "learned from presses"
        volts = np.concatenate([known.quiet.scan(pattern, 0).voltages for pattern in patterns])[idle]
        usual, advice = known.noise / float(np.sqrt(np.nanmean(volts**2))), "learn from presses of this skin"
    elif len(calibration.unexplained) == 2:
        then, made = np.concatenate([known.model.voltages(pattern) for pattern in patterns]), "calibrated"
        usual, advice = calibration.unexplained[1], "run `ohmskin calibrate` again"
    else:
        described = known.skin.conductivity_on(known.model.mesh)
        warnings = wrong_units(float(np.median(known.model.conductivity) / np.median(described)))
        match = quiet_match(known, patterns[0])
        return [*warnings, *(match.report() if match is not None and match.doubtful else [])]
    compared = idle & np.isfinite(now) & np.isfinite(then)
    now, then = now[compared], then[compared]
    if not (size := float(now @ now)):
        return []
    left = now - then * float(now @ then) / max(float(then @ then), 1e-300)
    share = float(np.sqrt(left @ left / size))
    if share <= max(_LEAST, _TIMES * usual):
        return []
    return [
        f"the quiet voltages are {100 * share:.2g} % unlike those of the skin that was {made}, at any conductivity: "
        f"this is another skin, or it has changed; {advice}"
    ]
