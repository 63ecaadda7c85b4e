"""What is compared frame by frame: which injections a frame has, and how a place is made of its data."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ohmskin.drive import complete_pattern
from ohmskin.errors import OhmskinError
from ohmskin.evaluate.methods import place_of
from ohmskin.evaluate.policies.lab import Lab, Scan
from ohmskin.geometry.domain import Floats
from ohmskin.inverse import Image
from ohmskin.scan import Cost, Difference, DrivePattern
from ohmskin.skin import Skin


@dataclass(frozen=True)
class Scheme:
    """Which injections a frame has.

    Args:
        key: Short name, such as ``16O/28``: a mode and its number of injections.
        mode: Name of the mode, see `Lab.mode`.
        injections: Of a frame. Fixed patterns are driven over and over until they are that many.
        title: What it drives, in a few words.
    """

    key: str
    mode: str
    injections: int
    title: str

    def gather(self, lab: Lab, scan: Scan) -> tuple[Image, tuple[Difference, ...]]:
        """The image of one frame, made as the paper makes it, and the data behind it."""
        mode = lab.mode(self.mode, self.injections)
        if mode.optimal is not None:
            return lab.cycle(mode, scan)
        data = tuple(scan(pattern) for pattern in rounds(mode.base, self.injections))
        return lab.imager.reconstruct(*data), data


def rounds(pattern: DrivePattern, injections: int) -> list[DrivePattern]:
    """A pattern driven over and over until there are so many injections; the last round may be a part of it."""
    full, rest = divmod(injections, pattern.n_inj)
    return [pattern] * full + ([next(pattern.split(rest))] if rest else [])


TITLES = {
    "12B": "adjacent drive, 12 electrodes on the rim",
    "16I": "adjacent drive, 12 electrodes on the rim and 4 inside",
    "16O": "the paper's: 12B, then pairs by eq. (7); both scans used",
    "16P": "6 opposite drives on all electrodes, then pairs by position information",
}
_USUAL = {"12B": 12, "16I": 16, "16O": 28, "16P": 28}


def scheme(key: str) -> Scheme:
    """The scheme of a key: a mode, or a mode and its injections, such as ``16P/16``.

    Raises:
        OhmskinError: If there is none.
    """
    mode, _, count = key.partition("/")
    if mode not in TITLES or not (count.isdigit() or not count):
        raise OhmskinError(f"no scheme {key!r}; choose from {', '.join(TITLES)}, with /INJECTIONS if not the usual number")
    return Scheme(key, mode, int(count) if count else _USUAL[mode], TITLES[mode])


INSTRUMENTS = ("parallel", "multiplexed")
YARDSTICK = "16O"  # whose time on an instrument all schemes get


def within(key: str, instrument: str, lab: Lab) -> Scheme:
    """A scheme with as many injections as it has time for while the paper's does its own, on an instrument with the skin's times.

    ``parallel`` instruments convert all voltages of an injection at once, as the paper's does; ``multiplexed`` ones one by one.

    Raises:
        OhmskinError: If there is no such instrument or scheme.
    """
    cost = instrument_cost(instrument, lab.skin)
    base = lab.mode(YARDSTICK, _USUAL[YARDSTICK]).base
    complete = complete_pattern(lab.electrodes)
    seconds = cost.time(base) + (_USUAL[YARDSTICK] - base.n_inj) * cost.time(next(complete.split(1)))
    if key == YARDSTICK:
        return scheme(key)
    usual = scheme(key)
    mode = lab.mode(usual.mode, usual.injections)
    one = cost.time(next((mode.base if mode.optimal is None else complete).split(1)))
    return replace(usual, injections=int(seconds / one * (1 + 1e-9)))


def instrument_cost(instrument: str, skin: Skin) -> Cost:
    """What scans cost on an instrument with the times of a skin's.

    Raises:
        OhmskinError: If there is no such instrument.
    """
    if instrument not in INSTRUMENTS:
        raise OhmskinError(f"no instrument {instrument!r}; choose from {', '.join(INSTRUMENTS)}")
    return replace(skin.cost, channels=0 if instrument == "parallel" else 1)


def centroid(lab: Lab, image: Image, data: tuple[Difference, ...]) -> Floats:
    """Where the image is highest: the centroid of the part about its peak above half of it (the paper's way)."""
    return place_of(image.values, lab.model.mesh)


def fit(lab: Lab, image: Image, data: tuple[Difference, ...]) -> Floats:
    """Where the strongest contact is that explains the data significantly; NaN if none does."""
    params = lab.explainer.fit(*data).params
    return params[np.argmax(params[:, 2]), :2] if len(params) else np.full(2, np.nan)


def disc_fit(lab: Lab, image: Image, data: tuple[Difference, ...]) -> Floats:
    """Where one disc fits the data best, without a test whether there is one."""
    return lab.disc_fit.fit(*data).contacts[0].position


Estimator = Callable[[Lab, Image, tuple[Difference, ...]], Floats]
ESTIMATORS: dict[str, Estimator] = {"centroid": centroid, "fit": fit, "one disc": disc_fit}
