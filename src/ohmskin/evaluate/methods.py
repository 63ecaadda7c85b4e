"""The drive methods that are compared, and the bench on which they all see the same contact under the same noise.

One rule sets the regularisation of all: the noise's standard deviation sigma in volts and the prior amplitude s, so that
lambda = sigma^2 mean(diag R^-1) / s^2 (`ohmskin.inverse.GaussNewton`, with no model error added).
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from ohmskin.drive import LocalDrive, Mode, modes
from ohmskin.errors import OhmskinError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.worlds import CURRENT, Contacts
from ohmskin.forward import TransferModel
from ohmskin.geometry import Mesh, Raster
from ohmskin.geometry.domain import Floats
from ohmskin.inverse import GaussNewton, Image
from ohmskin.scan import Difference, DrivePattern
from ohmskin.skin import Skin
from ohmskin.skin.description import Imaging
from ohmskin.touch import Contact, ContactFinder, find_regions, learn_threshold

PIXELS = 64  # of the images that figures of merit are taken from, along a side
_QUIET = 40  # cycles without a contact, from which gamma_0 is learned


@dataclass(frozen=True)
class Method:
    """One row of the comparison.

    Args:
        key: Short name, such as ``16O``.
        label: Name in tables, the paper's where it has one.
        title: What it does, in a few words.
        layout: Electrode layout (`worlds.LAYOUTS`).
        mode: What it drives.
    """

    key: str
    label: str
    title: str
    layout: str
    mode: Mode = field(repr=False)

    @property
    def injections(self) -> int:
        """Injections per image."""
        return self.mode.base.n_inj + (self.mode.optimal.pairs if self.mode.optimal else 0)


@lru_cache(maxsize=1)
def all_methods() -> dict[str, Method]:
    """The methods by their keys, in the order of the tables; the last one is the best mode that ohmskin has."""
    grid, rim = (Skin.load(name).electrodes for name in worlds.LAYOUTS.values())
    fused, literal, outer = modes(grid), modes(grid, fuse=False), modes(rim)
    local = Mode("local", "adaptive, short pairs near the contact", fused["12B"].base, LocalDrive(grid), fuse=True)
    listed = (
        Method("12B", "12_Electrodes_B", "adjacent drive, 12 electrodes on the rim", "grid", fused["12B"]),
        Method("16B", "16_Electrodes_B", "adjacent drive, 16 electrodes on the rim", "rim", outer["16B"]),
        Method("16I", "16_Electrodes_I", "adjacent drive, 12 electrodes on the rim and 4 inside", "grid", fused["16I"]),
        Method("local", "reference [14]", "12B, then short pairs near the contact; both scans fused", "grid", local),
        Method("16O", "16_Electrodes_O", "12B, then pairs by eq. (7); image of the second scan alone", "grid", literal["16O"]),
        Method("16O+", "16_Electrodes_O, fused", "12B, then pairs by eq. (7); image of both scans", "grid", fused["16O"]),
    )
    return {method.key: method for method in listed}


METHODS = ("12B", "16B", "16I", "local", "16O", "16O+")
BEST = METHODS[-1]


def method(key: str) -> Method:
    """The method with that key.

    Raises:
        OhmskinError: If there is none.
    """
    if key not in all_methods():
        raise OhmskinError(f"no method {key!r}; choose from {', '.join(all_methods())}")
    return all_methods()[key]


@dataclass(frozen=True)
class View:
    """What one method saw of one contact under one seed.

    Args:
        image: The final image.
        differences: The data behind it: one scan or two.
        mesh: Mesh of the image.
        raster: Its raster of `PIXELS` pixels.
        finder: Finds contacts in it, with the threshold learned of this method's quiet images.
    """

    image: Image
    differences: tuple[Difference, ...]
    mesh: Mesh = field(repr=False)
    raster: Raster = field(repr=False)
    finder: ContactFinder

    @property
    def pixels(self) -> Floats:
        """The image on pixels (ny, nx); NaN off the sheet."""
        return self.raster(self.image.values)

    @property
    def place(self) -> Floats:
        """Where the contact is (2,) in metres: the centroid of the part about the peak that is above half of it."""
        return place_of(self.image.values, self.mesh)

    @property
    def contacts(self) -> list[Contact]:
        """All contacts found, strongest peak first."""
        return self.finder.find(self.image, self.mesh)


def place_of(values: Floats, mesh: Mesh) -> Floats:
    """Centroid (2,) in metres of the part of an image about its peak that is above half of it; NaN where nothing is positive."""
    return find_regions(values, mesh, float(values.max()) / 2)[0].centroid if values.max() > 0 else np.full(2, np.nan)


class Bench:
    """All methods in one world, at one noise level and prior amplitude.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB, see `worlds`).
        amplitude: Prior amplitude s (relative conductivity change).
    """

    def __init__(self, world: str, decibels: float, amplitude: float) -> None:
        self.world, self.noise, self.amplitude = world, worlds.noise_volts(world, decibels), amplitude
        self._desks = {layout: _Desk(world, layout, self.noise, amplitude) for layout in worlds.LAYOUTS}
        self._gamma: dict[str, tuple[float, float]] = {}

    def model(self, layout: str) -> TransferModel:
        """The estimator's model of a layout, its conductivity scaled to the untouched sheet."""
        return self._desks[layout].model

    def see(self, key: str, contacts: Contacts, seed: int) -> View:
        """What a method sees of contacts. Methods that share a scan share its noise; another seed, other noise."""
        chosen = method(key)
        desk, settings = self._desks[chosen.layout], _skin(chosen.layout).imaging
        gamma_base, gamma = self._thresholds(chosen)
        image, data = self._look(chosen, contacts, seed, gamma_base)
        return View(image, data, desk.model.mesh, desk.raster, ContactFinder(gamma, settings.fraction, settings.dip))

    def _thresholds(self, chosen: Method) -> tuple[float, float]:
        """gamma_0 (eq. 6) of the base image and of the final one."""
        if chosen.key not in self._gamma:
            desk = self._desks[chosen.layout]
            base, final = [], []
            for quiet in range(_QUIET):
                first = desk.reconstruct(self._measure(chosen, chosen.mode.base, (), -1 - quiet))
                base.append(float(first.values.max()))
                last = self._look(chosen, (), -1 - quiet, np.inf)[0] if chosen.mode.optimal else first
                final.append(float(last.values.max()))
            self._gamma[chosen.key] = learn_threshold(base), learn_threshold(final)
        return self._gamma[chosen.key]

    def _look(self, chosen: Method, contacts: Contacts, seed: int, gamma: float) -> tuple[Image, tuple[Difference, ...]]:
        desk = self._desks[chosen.layout]

        def measure(pattern: DrivePattern) -> Difference:
            return self._measure(chosen, pattern, contacts, seed)

        return look(chosen.mode, measure, desk.reconstruct, desk.model.mesh, _skin(chosen.layout).imaging, gamma)

    def _measure(self, chosen: Method, pattern: DrivePattern, contacts: Contacts, seed: int) -> Difference:
        entropy = [abs(seed), int(seed < 0), pattern.digest, zlib.crc32(repr(contacts).encode())]
        noise = self.noise * np.random.default_rng(entropy).standard_normal(pattern.n_meas)
        if not contacts:
            return Difference(pattern, np.full(pattern.n_meas, CURRENT), noise)
        change = worlds.touched(self.world, chosen.layout, contacts) - worlds.sheet(self.world, chosen.layout).untouched
        return Difference(pattern, np.full(pattern.n_meas, CURRENT), worlds.voltages(change, pattern) + noise)


def look(
    mode: Mode,
    measure: Callable[[DrivePattern], Difference],
    reconstruct: Callable[..., Image],
    mesh: Mesh,
    imaging: Imaging,
    gamma: float,
) -> tuple[Image, tuple[Difference, ...]]:
    """The cycle of `ohmskin.engine.Perception`: base scan, regions above `gamma`, chosen pairs, final image, and its data."""
    first = measure(mode.base)
    base = reconstruct(first)
    if mode.optimal is None:
        return base, (first,)
    cut = max(gamma, imaging.fraction * float(base.values.max()))
    anchors = [region.anchors for region in find_regions(base.values, mesh, cut, imaging.dip)]
    if not anchors:  # nothing stands out: look closer where the image is highest
        peak = mesh.centroids[int(np.argmax(base.values))]
        anchors = [mesh.centroids[mesh.closest_elements(peak[None], 3)[0]]]
    second = measure(mode.optimal.pattern(anchors))
    data = (first, second) if mode.fuse else (second,)
    return reconstruct(*data), data


class _Desk:
    """The estimator of one electrode layout, made when it is first used."""

    def __init__(self, world: str, layout: str, noise: float, amplitude: float) -> None:
        self._world, self._layout, self._noise, self._amplitude = world, layout, noise, amplitude

    @cached_property
    def model(self) -> TransferModel:
        return scaled_model(self._world, self._layout)

    @cached_property
    def raster(self) -> Raster:
        return _raster(self._world, self._layout)

    @cached_property
    def _estimator(self) -> GaussNewton:
        return GaussNewton(self.model, self._noise, amplitude=self._amplitude)

    def reconstruct(self, *differences: Difference) -> Image:
        return self._estimator.reconstruct(*differences)


@lru_cache(maxsize=8)
def scaled_model(world: str, layout: str) -> TransferModel:
    """The estimator's model of a layout, its conductivity fitted to the untouched sheet as a calibration does."""
    skin = _skin(layout)
    model, pattern = skin.transfer_model(), next(iter(skin.modes.values())).base
    measured, modelled = worlds.voltages(worlds.sheet(world, layout).untouched, pattern) / CURRENT, model.voltages(pattern)
    return model.scaled(float(modelled @ modelled / (modelled @ measured)))


@lru_cache(maxsize=8)
def _raster(world: str, layout: str) -> Raster:
    return Raster(scaled_model(world, layout).mesh, PIXELS)


@lru_cache(maxsize=4)
def _skin(layout: str) -> Skin:
    return Skin.load(worlds.LAYOUTS[layout])


@lru_cache(maxsize=6)
def bench(world: str, decibels: float, amplitude: float) -> Bench:
    """The bench of that world, noise and amplitude; made once per process."""
    return Bench(world, decibels, amplitude)
