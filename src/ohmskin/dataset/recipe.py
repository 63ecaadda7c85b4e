"""What a data set is made of: which skin, which contacts, which pattern, which seed."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import DataError
from ohmskin.geometry import Raster
from ohmskin.scan import DrivePattern, all_pairs, measure_others
from ohmskin.sensing import drive_of, modes
from ohmskin.skin import Press, Skin, VirtualSkin

COMPLETE = "complete"
_TRIES = 200  # places tried for a contact that must keep its distance
_CONTACTS = 4  # between sheet and patch along each side: twice as quick as with the twin's own six


@dataclass(frozen=True)
class Recipe:
    """Everything that a data set depends on; equal recipes make equal data on any machine.

    Sample `i` draws all its numbers from the seed sequence (seed, i): the number of contacts (uniform), and for each
    the place (uniform on the sheet), the radius (uniform) and the pressure (uniform in its logarithm).

    Args:
        skin: Description of the skin, as TOML text.
        pattern: What is driven: a mode of the skin (its base scan), or ``complete``, all electrode pairs, which
            contains every other pattern.
        contacts: Least and largest number of contacts.
        radius: Least and largest radius of a contact (m).
        pressure: Least and largest pressure (Pa).
        gap: Least distance between the rims of two contacts (m).
        pixels: Pixels of the truth along the longer side of the sheet.
        seed: Seed of everything.

    Raises:
        DataError: If a value is out of range.
        SkinError: If the skin is not valid.
    """

    skin: str = field(repr=False)
    pattern: str = COMPLETE
    contacts: tuple[int, int] = (0, 3)
    radius: tuple[float, float] = (4e-3, 15e-3)
    pressure: tuple[float, float] = (1e3, 60e3)
    gap: float = 5e-3
    pixels: int = 32
    seed: int = 0

    def __post_init__(self) -> None:
        skin = Skin.parse(self.skin)
        if self.pattern not in (choices := [COMPLETE, *modes(skin)]):
            raise DataError(f"no pattern {self.pattern!r}; choose from {', '.join(choices)}")
        x0, y0, x1, y1 = skin.domain.bounds
        ranges = (
            ("contacts", self.contacts, 0, 16),
            ("radius", self.radius, 1e-4, min(x1 - x0, y1 - y0) / 2),
            ("pressure", self.pressure, 1.0, 1e7),
        )
        for name, (low, high), least, most in ranges:
            if not least <= low <= high <= most:
                allowed = f"the first must not exceed the second, within {least:g} to {most:g}"
                raise DataError(f"{name} are {low:g} to {high:g}; {allowed}")
        if not 0 <= self.gap <= max(x1 - x0, y1 - y0):
            raise DataError(f"gap is {self.gap:g} m; it must be 0 to the length of the sheet")
        if not 2 <= self.pixels <= 1024:
            raise DataError(f"{self.pixels} pixels; choose 2 to 1024")
        if not 0 <= self.seed < 2**63:
            raise DataError(f"seed is {self.seed}; it must be 0 to 2^63 - 1")

    def presses(self, index: int) -> tuple[Press, ...]:
        """The contacts of one sample; fewer than drawn where there is no room for more.

        Args:
            index: Number of the sample, from 0.
        """
        random = np.random.default_rng([self.seed, index])
        domain = _simulator(self).skin.domain
        x0, y0, x1, y1 = domain.bounds
        placed: list[Press] = []
        for _ in range(random.integers(self.contacts[0], self.contacts[1], endpoint=True)):
            radius = random.uniform(*self.radius)
            pressure = float(np.exp(random.uniform(*np.log(self.pressure))))
            places = random.uniform((x0, y0), (x1, y1), (_TRIES, 2))
            free = domain.depth(places) >= 0
            for other in placed:
                free &= np.linalg.norm(places - other.position, axis=1) >= radius + other.radius + self.gap
            if not free.any():
                break
            x, y = places[np.argmax(free)]
            placed.append(Press((float(x), float(y)), float(radius), pressure))
        return tuple(placed)

    def simulate(self, first: int, count: int) -> dict[str, np.ndarray]:
        """Samples `first` to `first + count - 1`, by array name; see `arrays`."""
        simulator = _simulator(self)
        samples: dict[str, np.ndarray] = {
            name: np.full((count, *one.sizes.values()), one.fill, one.kind) for name, one in self.arrays().items()
        }
        for row, index in enumerate(range(first, first + count)):
            presses = self.presses(index)
            simulator.twin.reset([self.seed, index, 1], presses)
            frame = simulator.twin.scan(simulator.pattern)
            samples["voltages"][row], samples["currents"][row] = frame.voltages, frame.currents
            samples["count"][row] = len(presses)
            for k, press in enumerate(presses):
                samples["contacts"][row, k] = *press.position, press.radius, press.pressure
            samples["truth"][row] = simulator.pressure(presses)
        return samples

    def quiet(self, count: int = 32) -> Floats:
        """Voltages (count, n_meas) of the untouched skin (V), with the noise of its instrument."""
        simulator = _simulator(self)
        simulator.twin.reset([self.seed, 0, 2])
        return np.array([simulator.twin.scan(simulator.pattern).voltages for _ in range(count)])

    @property
    def drive_pattern(self) -> DrivePattern:
        """The drive pattern of every sample."""
        return _simulator(self).pattern

    def arrays(self) -> dict[str, "Array"]:
        """The arrays of a sample, by name."""
        simulator = _simulator(self)
        ny, nx = simulator.raster.inside.shape
        n_meas, n_inj, most = simulator.pattern.n_meas, simulator.pattern.n_inj, max(1, self.contacts[1])
        return {
            "voltages": Array({"measurement": n_meas}, "V, in the order of pattern_measurements; infinite if clipped"),
            "currents": Array({"injection": n_inj}, "A, measured, in the order of pattern_injections"),
            "contacts": Array(
                {"contact": most, "parameter": 4}, "x (m), y (m), radius (m), pressure (Pa); NaN beyond count"
            ),
            "count": Array({}, "number of contacts", np.uint8, 0),
            "truth": Array({"y": ny, "x": nx}, "Pa on pixels, row 0 at the smallest y; 0 off the sheet", fill=0.0),
        }

    @property
    def pixel_centres(self) -> tuple[Floats, Floats]:
        """x (nx,) and y (ny,) of the pixels of the truth (m)."""
        raster = _simulator(self).raster
        return raster.x, raster.y


@dataclass(frozen=True)
class Array:
    """One array of a data set, without the axis of its samples.

    Args:
        sizes: Of its axes, by name.
        meaning: What its values are.
        kind: Of its numbers.
        fill: What stands where nothing is.
    """

    sizes: dict[str, int]
    meaning: str
    kind: type = np.float32
    fill: float = np.nan


class _Simulator:
    """The twin that simulates a recipe's samples; it takes time to make, and all samples share it."""

    def __init__(self, recipe: Recipe) -> None:
        self.skin = Skin.parse(recipe.skin)
        self.twin = VirtualSkin(self.skin, contacts=_CONTACTS)
        n_elec = len(self.skin.electrodes)
        self.pattern = (
            measure_others(all_pairs(n_elec), range(n_elec))
            if recipe.pattern == COMPLETE
            else drive_of(modes(self.skin)[recipe.pattern], self.skin).next((), 0)
        )
        self.raster = Raster(self.twin.sheet.mesh, recipe.pixels)
        self._centres = np.stack(np.meshgrid(self.raster.x, self.raster.y), axis=-1)

    def pressure(self, presses: tuple[Press, ...]) -> Floats:
        """Pressure (ny, nx) at pixel centres in pascals, spread by the foam as the twin spreads it."""
        spread = self.skin.contact_layer.foam_spread
        total = np.zeros(self.raster.inside.shape)
        for press in presses:
            total += press.pressure_at(self.twin.sheet.distances(self._centres, press), spread)
        return np.where(self.raster.inside, total, 0.0)


@lru_cache(maxsize=2)
def _simulator(recipe: Recipe) -> _Simulator:
    return _Simulator(recipe)
