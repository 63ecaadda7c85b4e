"""The lab in which policies are compared: what is true of a touched sheet, and what an estimator believes of it.

Truth and noise are those of `ohmskin.evaluate.worlds`. What is believed may be wrong, see `Flaw`. A scan of given contacts under a
given seed has the same noise whoever drives it, so that all sensors meet the same luck.
"""

import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ohmskin.drive import Candidates, InformedPolicy, Mode, PositionDrive, base_pattern, complete_pattern, modes
from ohmskin.errors import OhmskinError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.methods import look
from ohmskin.evaluate.worlds import CURRENT, Contacts
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.geometry import Electrodes, Mesh, mesh_domain
from ohmskin.geometry.domain import Floats
from ohmskin.inverse import DiscFit, GaussNewton, Image
from ohmskin.scan import Difference, DrivePattern, adjacent
from ohmskin.skin import Skin
from ohmskin.touch import learn_threshold
from ohmskin.touch.explain import Explainer

AMPLITUDE = 0.1  # prior amplitude of all images, as in the reproduction and on the live page
RADIUS = 8e-3  # metres; what estimators expect of a contact, neither world's own
_QUIET = 40  # cycles without a contact, from which gamma_0 is learned
_WAVES = 4  # half waves along a side of the sheet, up to which the believed conductivity is wavy

Scan = Callable[[DrivePattern], Difference]


@dataclass(frozen=True)
class Flaw:
    """What is wrong with the model, or with the skin since its calibration.

    Args:
        wear: Contact impedance of the electrodes over the usual one.
        since: Whether it grew after the calibration, so that the reference does not know it.
        misplaced: Distance between where an electrode is and where it is believed to be (m); in a random direction, on the rim
            along it.
        uneven: Standard deviation of the believed conductivity, as a share; smooth, with half waves of 50 mm and longer.
        draw: Which random directions and waves.
    """

    wear: float = 1.0
    since: bool = False
    misplaced: float = 0.0
    uneven: float = 0.0
    draw: int = 0


SOUND = Flaw()


class Lab:
    """One world at one noise level, and one estimator's idea of it.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB, see `worlds`).
        flaw: What is wrong.

    Attributes:
        noise: Standard deviation of a voltage (V).
        electrodes: Where the electrodes are believed to be.
        model: The estimator's model, its conductivity fitted to the untouched sheet as a calibration does.
    """

    def __init__(self, world: str, decibels: float, flaw: Flaw = SOUND) -> None:
        self.world, self.flaw, self.noise = world, flaw, worlds.noise_volts(world, decibels)
        self.skin = Skin.load(worlds.LAYOUTS["grid"])
        self.electrodes, self.model = believed(world, flaw)
        self._gamma: dict[str, float] = {}
        self._policies: dict[int, InformedPolicy] = {}
        self._modes: dict[tuple[str, int], Mode] = {}

    def mode(self, name: str, injections: int) -> Mode:
        """A mode on the electrodes as they are believed to be; adaptive ones with so many injections, the base scan included.

        Raises:
            OhmskinError: If there is no such mode, or no injection is left for an adaptive one to choose.
        """
        if (name, injections) not in self._modes:
            self._modes[name, injections] = self._make(name, injections)
        return self._modes[name, injections]

    def _make(self, name: str, injections: int) -> Mode:
        if name == "16P":
            base = base_pattern(self.electrodes)
            drive = PositionDrive(self.electrodes, lambda: self.design, injections - base.n_inj, base.injections)
            return Mode(name, "opposite drives, then by position information", base, drive)
        paper = modes(self.electrodes)
        if name not in paper:
            raise OhmskinError(f"no mode {name!r}; choose from {', '.join([*paper, '16P'])}")
        if paper[name].optimal is None:
            return paper[name]
        return modes(self.electrodes, injections - paper[name].base.n_inj)[name]

    @cached_property
    def design(self) -> tuple[ContactTable, Candidates]:
        """What informed policies choose from: the responses of contacts, and all injections at `CURRENT`."""
        complete = complete_pattern(self.electrodes)
        return self.table, Candidates.at_currents(complete, len(self.electrodes), self.noise, CURRENT)

    @cached_property
    def imager(self) -> GaussNewton:
        """Makes images as the paper does; the noise is known, and no model error added."""
        return GaussNewton(self.model, self.noise, amplitude=AMPLITUDE)

    @cached_property
    def disc_fit(self) -> DiscFit:
        """Fits one disc, whatever the data."""
        return DiscFit(self.model, self.noise, RADIUS, count=1)

    @cached_property
    def explainer(self) -> Explainer:
        """Fits as many contacts as there are."""
        return Explainer(self.table, self.noise)

    def policy(self, injections: int) -> InformedPolicy:
        """What mode ``16T`` asks of a skin; its tables are made once."""
        if injections not in self._policies:
            self._policies[injections] = InformedPolicy(self.electrodes, lambda: self.design, injections)
        return self._policies[injections]

    @property
    def table(self) -> ContactTable:
        """Responses of contacts."""
        return table(self.world, self.flaw)

    @property
    def _untouched(self) -> Floats:
        return untouched(self.world, self.flaw)

    def scan(self, contacts: Contacts, *seed: int) -> Scan:
        """A device that measures the sheet under contacts: differences at `CURRENT`, with noise of its seed."""
        change: Floats | None = None
        if contacts or self.flaw.since:
            now = worlds.touched(self.world, "grid", contacts, self.flaw.wear)
            change = now - self._untouched
        entropy = [*seed, zlib.crc32(repr(contacts).encode())]
        driven: Counter[int] = Counter()

        def measure(pattern: DrivePattern) -> Difference:
            driven[pattern.digest] += 1  # the same pattern again has other noise
            random = np.random.default_rng([*entropy, pattern.digest, driven[pattern.digest]])
            volts = self.noise * random.standard_normal(pattern.n_meas)
            if change is not None:
                volts = volts + worlds.voltages(change, pattern)
            return Difference(pattern, np.full(pattern.n_meas, CURRENT), volts)

        return measure

    def reference(self, pattern: DrivePattern) -> Floats:
        """Voltages (n_meas,) of the untouched sheet as it was calibrated (V)."""
        return worlds.voltages(self._untouched, pattern)

    def cycle(self, mode: Mode, scan: Scan) -> tuple[Image, tuple[Difference, ...]]:
        """One cycle of a mode as `ohmskin.engine.Perception` runs it: the final image and the data behind it."""
        return look(mode, scan, self.imager.reconstruct, self.model.mesh, self.skin.imaging, self._threshold(mode))

    def _threshold(self, mode: Mode) -> float:
        """gamma_0 (eq. 6) of the base image."""
        if mode.optimal is None:
            return np.inf
        if mode.name not in self._gamma:
            quiet = [self.imager.reconstruct(self.scan((), 1, k)(mode.base)).values.max() for k in range(_QUIET)]
            self._gamma[mode.name] = learn_threshold(quiet)
        return self._gamma[mode.name]


@lru_cache(maxsize=8)
def believed(world: str, flaw: Flaw) -> tuple[Electrodes, TransferModel]:
    """Where the electrodes are believed to be, and the estimator's model, fitted to the untouched sheet as a calibration does."""
    skin, random = Skin.load(worlds.LAYOUTS["grid"]), np.random.default_rng([flaw.draw, 7])
    electrodes = misplaced(skin, flaw.misplaced, random)
    mesh = mesh_domain(skin.domain, skin.imaging.mesh_size, electrodes.positions)
    conductivity = skin.sheet.conductivity * (1 + flaw.uneven * waves(mesh, random))
    model, pattern = TransferModel(mesh, electrodes, conductivity), adjacent([electrodes.rings[0]])
    measured, modelled = worlds.voltages(untouched(world, flaw), pattern) / CURRENT, model.voltages(pattern)
    return electrodes, model.scaled(float(modelled @ modelled / (modelled @ measured)))


@lru_cache(maxsize=8)
def table(world: str, flaw: Flaw) -> ContactTable:
    """Responses of contacts by the estimator's model."""
    return ContactTable(believed(world, flaw)[1], RADIUS)


def untouched(world: str, flaw: Flaw) -> Floats:
    """Transfer resistances (n_elec, n_elec) of the sheet when it was calibrated (ohm)."""
    return worlds.sheet(world, "grid", 1.0 if flaw.since else flaw.wear).untouched


def misplaced(skin: Skin, distance: float, random: np.random.Generator) -> Electrodes:
    """The electrodes of a rectangular skin, each moved by a distance (m): inner ones anywhere, those on the rim along it."""
    true = skin.electrodes
    if not distance:
        return true
    angle = random.uniform(0, 2 * np.pi, len(true))
    moves = distance * np.column_stack([np.cos(angle), np.sin(angle)])
    high = np.array([skin.sheet.width, skin.sheet.height])
    on_side = (true.positions < 1e-9) | (true.positions > high - 1e-9)  # (n_elec, 2)
    along = np.where(on_side[:, :1], [0.0, 1.0], [1.0, 0.0]) * distance * np.sign(moves[:, :1])
    moved = true.positions + np.where(on_side.any(axis=1, keepdims=True), along, moves)
    outside = (moved < 0) | (moved > high)  # a corner moves along whichever of its sides is there
    moved = np.where(outside, 2 * true.positions - moved, moved)
    return true.mapped(lambda _: moved)


def waves(mesh: Mesh, random: np.random.Generator) -> Floats:
    """A smooth random field (n_elem,) of mean zero and standard deviation one over the sheet."""
    at = (mesh.centroids - mesh.nodes.min(axis=0)) / np.ptp(mesh.nodes, axis=0)
    kx, ky = np.meshgrid(np.arange(_WAVES + 1), np.arange(_WAVES + 1))
    terms = np.cos(np.pi * np.outer(at[:, 0], kx.ravel())) * np.cos(np.pi * np.outer(at[:, 1], ky.ravel()))
    field = terms @ random.standard_normal(kx.size)
    field -= np.average(field, weights=mesh.measures)
    unit: Floats = field / np.sqrt(np.average(field**2, weights=mesh.measures))
    return unit


@lru_cache(maxsize=6)
def lab(world: str, decibels: float, flaw: Flaw = SOUND) -> Lab:
    """The lab of that world, noise and flaw; made once per process."""
    return Lab(world, decibels, flaw)
