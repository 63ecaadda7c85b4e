"""Whether the untouched skin is the one that was calibrated, learned or described: its quiet voltages tell."""

import numpy as np

from ohmskin.arrays import Bools
from ohmskin.inverse.quality import wrong_units
from ohmskin.sensing.confidence import quiet_match
from ohmskin.sensing.model import SkinModel

UNLIKE = 0.025  # share by which they differ from a description's, from which on contacts are located the worse for it
_LEAST, _TIMES = 0.02, 5.0  # share by which they differ at least, and over what was left then, or over the noise


def changed_since(known: SkinModel, live: bool = False) -> list[str]:
    """What to say where the quiet voltages of `known` are not those of the skin as it was calibrated or learned, or as
    it is described; of a `live` skin also where a calibration would bring its description nearer to it.

    The conductivity as a whole, and the contacts of electrodes, may have changed: voltages of idle electrodes are
    compared, at the best common factor.
    """
    calibration, patterns = known.skin.calibration, known.quiet.patterns
    idle = ~np.concatenate([pattern.driven for pattern in patterns])
    now = np.concatenate([known.baseline.reference(pattern) for pattern in patterns])
    most, why = _LEAST, "this is another skin, or it has changed; "
    if calibration.channel_resistances:
        then = np.concatenate([calibration.resting(pattern) for pattern in patterns])
        most = max(most, _TIMES * _noise(known, idle))
        made, why = "that was learned from presses", f"{why}learn from presses of this skin"
    elif len(calibration.unexplained) == 2:
        most = max(most, _TIMES * calibration.unexplained[1])
        made, why = "that was calibrated", f"{why}run `ohmskin calibrate` again"
    else:
        described = known.skin.conductivity_on(known.model.mesh)
        warnings = wrong_units(float(np.median(known.model.conductivity) / np.median(described)))
        match = quiet_match(known, patterns[0])
        if warnings or not live or match is None or match.doubtful:
            return [*warnings, *(match.report() if match is not None and match.doubtful else [])]
        most, made = max(UNLIKE, _noise(known, idle)), "as described"
        why = "contacts are placed the worse for it; `ohmskin calibrate` estimates electrodes and sheet"
    if not calibration.channel_resistances:
        then = np.concatenate([known.model.voltages(pattern) for pattern in patterns])
    compared = idle & np.isfinite(now) & np.isfinite(then)
    now, then = now[compared], then[compared]
    if not (size := float(now @ now)):
        return []
    left = now - then * float(now @ then) / max(float(then @ then), 1e-300)
    share = float(np.sqrt(left @ left / size))
    if share <= most:
        return []
    return [f"the quiet voltages are {100 * share:.2g} % unlike those of the skin {made}, at any conductivity: {why}"]


def _noise(known: SkinModel, idle: Bools) -> float:
    """Noise of the quiet voltages that are `idle`, as a share of theirs (1)."""
    volts = np.concatenate([known.quiet.scan(pattern, 0).voltages for pattern in known.quiet.patterns])[idle]
    return known.noise / float(np.sqrt(np.nanmean(volts**2)))
