"""The drive methods of the reproduction, and the bench on which all see the same contact under the same noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.assumptions import STATED, assumption
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import Setup, View, setup
from ohmskin.evaluate.shapes import Shape, disc
from ohmskin.evaluate.worlds import Contacts, contact
from ohmskin.skin import Mode

Reading = Callable[[View, Contacts], dict[str, Any]]  # named numbers or arrays from the view of a case


@dataclass(frozen=True)
class Method:
    """One row of the comparison.

    Args:
        key: Short name, such as ``16O``.
        label: Name in tables, the paper's where it has one.
        title: A short description.
        layout: Electrode layout (`worlds.LAYOUTS`).
        drive: Name of its drive (`ohmskin.drive.DRIVES`).
        injections: Per image.
        fuse: Whether the image uses the base scan, too.
    """

    key: str
    label: str
    title: str
    layout: str
    drive: str
    injections: int
    fuse: bool = True

    @property
    def mode(self) -> Mode:
        """The product's mode of that drive: contacts are centroids of the image."""
        return Mode(self.key, self.drive, "centroid", injections=self.injections, fuse=self.fuse)

    def assuming(self, name: str) -> Mode:
        """The same under the assumption of that `name`, one of `ASSUMPTIONS`.

        Raises:
            OhmskinError: If there is no such assumption.
        """
        taken = assumption(name)
        mode = self.mode.using(prior=taken.prior)
        more = taken.pairs - STATED.pairs if self.drive in ("local", "eq7") else 0
        return replace(mode, injections=mode.injections + more, driven=taken.driven)


_ALL = (
    Method("12B", "12_Electrodes_B", "adjacent drive, 12 electrodes on the rim", "grid", "rim", 12),
    Method("16B", "16_Electrodes_B", "adjacent drive, 16 electrodes on the rim", "rim", "rim", 16),
    Method("16I", "16_Electrodes_I", "adjacent drive, 12 electrodes on the rim and 4 inside", "grid", "rings", 16),
    Method("local", "reference [14]", "12B, then short pairs near the contact; both scans fused", "grid", "local", 28),
    Method(
        "16O", "16_Electrodes_O", "12B, then pairs by eq. (7); image of the second scan alone", "grid", "eq7", 28, False
    ),
    Method("16O fused", "16_Electrodes_O, fused", "12B, then pairs by eq. (7); image of both scans", "grid", "eq7", 28),
)
METHODS = tuple(each.key for each in _ALL)
"""Keys of the methods compared, in the order of the tables."""


def all_methods() -> dict[str, Method]:
    """The methods by their keys, in the order of the tables; the last one is the paper's with all data used."""
    return {each.key: each for each in _ALL}


def method(key: str) -> Method:
    """The method with that key.

    Raises:
        OhmskinError: If there is none.
    """
    if key not in METHODS:
        raise OhmskinError(f"no method {key!r}; choose from {', '.join(METHODS)}")
    return all_methods()[key]


@dataclass(frozen=True)
class Bench:
    """All methods in one world, at one noise level and prior amplitude.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB, see `worlds`).
        amplitude: Prior amplitude s (relative conductivity change).
        assumption: The assumption that differs from the figures, one of `ASSUMPTIONS`.
    """

    world: str
    decibels: float
    amplitude: float
    assumption: str = field(default="stated", kw_only=True)

    def setup(self, layout: str) -> Setup:
        """The set-up with an electrode layout."""
        taken = assumption(self.assumption)
        return setup(self.world, self.decibels, self.amplitude * taken.amplitude, layout, assumption=taken)

    def usual_contact(
        self, x: float, y: float, radius: float | None = None, strength: float | None = None, times: float = 1.0
    ) -> Shape:
        """A contact, the usual one of the world unless given otherwise.

        Args:
            x, y: Its centre (m).
            radius: Its radius (m).
            strength: Relative conductivity change in it (1).
            times: Factor on the strength (1).
        """
        taken = assumption(self.assumption)
        usual = contact(self.world, x, y, radius, strength)
        return disc(x, y, taken.radius * usual.radius, taken.strength * times * usual.strength)

    def simulate(self, key: str, contacts: Contacts, seed: int) -> View:
        """The result of a method for some contacts.

        Args:
            key: Of the method.
            contacts: The pressed shapes.
            seed: Of the noise; methods that share a scan share it.

        Raises:
            OhmskinError: If there is no such method.
        """
        chosen = method(key)
        return self.setup(chosen.layout).simulate(chosen.assuming(self.assumption), contacts, seed, 0)

    def read(self, keys: Sequence[str], cases: Sequence[Contacts], seeds: int, what: Reading) -> Result:
        """Values computed from the views of each method, case and seed.

        Args:
            keys: Of the methods.
            cases: The contacts of each case.
            seeds: Number of seeds; they are 0, 1, ...
            what: Computes numbers or arrays, by name, from a view of contacts.

        Returns:
            By the same names, arrays (n_methods, n_cases, n_seeds, ...).
        """
        found = [what(self.simulate(key, case, seed), case) for key in keys for case in cases for seed in range(seeds)]
        shape = (len(keys), len(cases), seeds)
        return {name: np.reshape([row[name] for row in found], shape + np.shape(found[0][name])) for name in found[0]}


bench = Bench
