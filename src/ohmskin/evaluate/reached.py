"""What the reader of a mode reaches, beside the bound on its error: simulated contacts, read from one frame each."""

from dataclasses import replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.drive import Drive
from ohmskin.geometry.overlap import disc_overlap
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import SkinModel, build
from ohmskin.skin import Mode, Skin
from ohmskin.skin.calibration import Calibration

_QUIET = 40  # scans of the untouched skin
_PERIOD = 10e-3  # seconds between frames


def reached_errors(
    skin: Skin, mode: Mode, drive: Drive, noise: float, radius: float, places: Floats, frames: int
) -> Floats:
    """Position errors of discs that raise the conductivity by a half, as a mode reads them (m).

    The data are of the mode's own model of the skin, with white noise; what a real skin has besides is not in them.

    Args:
        skin: Whose model, currents and imaging are used.
        mode: Names the reader.
        drive: What is driven for it.
        noise: Standard deviation of a voltage (V).
        radius: Radius of the contacts on the skin (m).
        places: Their centres (n_places, 2) on the map (m).
        frames: How many each rests.

    Returns:
        Errors (n_places,) on the skin in metres, NaN where no contact was found.
    """
    model, random = skin.transfer_model(), np.random.default_rng(0)
    amperes, pairs = skin.pair_currents(), skin.pairs

    def simulated(touched: Floats, pattern: DrivePattern, count: int = 1) -> list[Frame]:
        currents, drawn = amperes[pairs.index(*pattern.injections.T)], int(random.integers(2**31))
        return model.with_conductivity(touched).simulate(pattern, currents, noise, count, drawn)

    quiet = [frame for pattern in drive.patterns for frame in simulated(model.conductivity, pattern, _QUIET)]
    sensor = build(mode, SkinModel(replace(skin, calibration=Calibration()), model, quiet), drive)
    errors, scales = np.full(len(places), np.nan), skin.chart.scale(places)
    for k, (place, scale) in enumerate(zip(places, scales, strict=True)):
        share = disc_overlap(model.mesh, place, radius / scale).toarray()[0] / model.mesh.measures
        touched, state = model.conductivity * (1 + 0.5 * share), sensor.start()
        for number in range(frames):

            def scan(pattern: DrivePattern, touched: Floats = touched, now: float = number * _PERIOD) -> Frame:
                return replace(simulated(touched, pattern)[0], time=now)

            state, percept = sensor.step(state, scan)
        found = percept.contacts if frames > 1 else percept.detections
        if found:
            strongest = max(found, key=lambda contact: contact.strength)
            errors[k] = scale * np.hypot(*(np.array(strongest.position) - place))
    return errors
