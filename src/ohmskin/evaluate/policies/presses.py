"""Presses: whether light and hard ones are detected as one contact, and how accurate their forces are."""

from copy import copy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts import Contact
from ohmskin.evaluate.policies.pairs import READING
from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import Setup, setup
from ohmskin.evaluate.shapes import disc
from ohmskin.scan import Difference
from ohmskin.sensing import KnownPress, PressFitter, fit_layer
from ohmskin.skin import Press, Skin

FOOT = 7e-3  # m, radius of what presses of known force are made with
KNOWN = (2e3, 4e3, 8e3, 15e3, 30e3)  # Pa, of those presses, two of each
LAYERS = ("as it is", "described wrongly", "after ten known presses")
WRONG = 1.5, -0.15  # factor on the layer's conductance, and what its exponent is off by, where described wrongly
_MARGIN = 20e-3  # m from a press to the rim


@dataclass(frozen=True)
class PressCounts:
    """How many contacts a press is.

    Args:
        decibels: Noise level (dB).
        seeds: Noise seeds of each.
        radius: Of the press (m).
        pressure: Its pressure (Pa).
        where: Places.
        schemes: Keys, see `schemes.scheme`.
    """

    decibels: float
    seeds: int
    radius: float
    pressure: float
    where: int = 24
    schemes: tuple[str, ...] = ("best", "16O fused", "16P")

    def run(self) -> Result:
        """Results: ``counted`` (n_schemes, n_where, n_seeds) contacts, ``away`` the same, from the press to the
        strongest (m), NaN where there is none."""
        world = setup("pressed", self.decibels)
        counted = np.zeros((len(self.schemes), self.where, self.seeds), int)
        away = np.full(counted.shape, np.nan)
        spots = places(self.where, 3, world.skin)
        for (s, key), (w, place), seed in product(enumerate(self.schemes), enumerate(spots), range(self.seeds)):
            there = (disc(place[0], place[1], self.radius, self.pressure),)
            seen = world.simulate(scheme(key, READING), there, seed)
            counted[s, w, seed] = len(seen.contacts)
            if seen.contacts:
                away[s, w, seed] = np.linalg.norm(seen.strongest - place)
        return {"counted": counted, "away": away}


@dataclass(frozen=True)
class ForceErrors:
    """Forces of presses, place, radius and pressure all unknown: of one frame of 16P and of several.

    Args:
        decibels: Noise level (dB).
        where: Places at each pressure.
        draw: Which places, noise, and known presses.
        frames: How many frames the longer look has.
        pressures: Pressures (Pa).
        radius: Of all presses (m).
    """

    decibels: float
    where: int
    draw: int = 0
    frames: int = 10
    pressures: tuple[float, ...] = (2e3, 6e3, 20e3, 60e3)
    radius: float = 8e-3

    def run(self) -> Result:
        """Results: ``force`` and ``std`` (2, n_layers, n_pressures, n_where) of one frame and of several, with each of
        `LAYERS` (N); ``true`` (n_pressures,); ``layer`` (2,), conductance over the true one and exponent found."""
        world, shape = setup("pressed", self.decibels), (2, len(LAYERS), len(self.pressures), self.where)
        skin = world.skin
        layer, (factor, off) = skin.contact_layer, WRONG
        wrong = replace(layer, conductance=factor * layer.conductance, exponent=layer.exponent + off)
        fitters = [PressFitter(world.known), self._fitter(world, replace(skin, contact_layer=wrong))]
        known = []
        for k, (x, y) in enumerate(places(len(KNOWN) * 2, 100 + self.draw, skin).tolist()):
            press = Press((x, y), FOOT, KNOWN[k % len(KNOWN)])
            contacts, frames = self._measured(world, press, k)
            known.append(KnownPress(press.force(layer.foam_spread), contacts[0], sum(frames, ())))
        found = fit_layer(fitters[1], known)
        calibrated = replace(skin, contact_layer=wrong, calibration=found.put_into(skin.calibration))
        fitters.append(self._fitter(world, calibrated))
        force, std = np.full(shape, np.nan), np.full(shape, np.nan)
        spots = places(self.where, 200 + self.draw, skin).tolist()
        for (p, pressure), (w, (x, y)) in product(enumerate(self.pressures), enumerate(spots)):
            contacts, frames = self._measured(world, Press((x, y), self.radius, pressure), 1000 + w)
            for (f, fitter), (n, scans) in product(enumerate(fitters), enumerate((frames[0], sum(frames, ())))):
                if contacts and (n or f == 0):
                    (fitted,) = fitter.fit(contacts[:1], *scans)
                    force[n, f, p, w], std[n, f, p, w] = fitted.force, fitted.force_std
        unit = Press((0.1, 0.1), self.radius, 1.0).force(layer.foam_spread)
        told = np.array([found.conductance / layer.conductance, found.exponent])
        return {"force": force, "std": std, "true": unit * np.array(self.pressures), "layer": told}

    def _fitter(self, world: Setup, skin: Skin) -> PressFitter:
        """A fitter that takes the world's skin for another."""
        known = copy(world.known)
        known.skin = skin
        return PressFitter(known)

    def _measured(
        self, world: Setup, press: Press, seed: int
    ) -> tuple[tuple[Contact, ...], list[tuple[Difference, ...]]]:
        """The contacts of the first frame that shows any, and the data of all frames."""
        shape = (disc(*press.position, press.radius, press.pressure),)
        views = [world.simulate(scheme("16P", READING), shape, self.draw, seed, frame) for frame in range(self.frames)]
        contacts = next((view.contacts for view in views if view.contacts), ())
        return contacts, [view.differences for view in views]


def places(count: int, seed: int, skin: Skin) -> Floats:
    """Places (count, 2) at random, off the rim (m)."""
    x0, y0, x1, y1 = skin.domain.bounds
    low, high = np.array([x0, y0]) + _MARGIN, np.array([x1, y1]) - _MARGIN
    return np.asarray(np.random.default_rng([seed, 21]).uniform(low, high, (count, 2)))
