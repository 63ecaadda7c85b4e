"""The experimental set-up: a world that is scanned like a device, with noise, and the sensors that look at it.

Truth and noise are those of `ohmskin.evaluate.worlds`. What is believed may be wrong, see `Flaw`. Sensors are those of
the loop (`ohmskin.sensing.build`), calibrated on `QUIET` scans of the untouched sheet. A scan of given contacts under a
given seed has the same noise whoever drives it, so that all sensors meet the same luck.
"""

import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from ohmskin import drive as drives
from ohmskin.arrays import Floats
from ohmskin.calibrate.sheet import fit_sheet
from ohmskin.contacts import Contact, ContactFinder, ContactFitter, find_regions
from ohmskin.drive import DRIVES, Drive, DriveSettings, complete_pattern
from ohmskin.evaluate import worlds
from ohmskin.evaluate.assumptions import STATED, Assumption
from ohmskin.evaluate.flaws import SOUND, Flaw, assumed_model
from ohmskin.evaluate.worlds import CURRENT, Contacts
from ohmskin.forward import ContactTable
from ohmskin.geometry import Mesh, Raster
from ohmskin.inverse import Image
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, adjacent, needed
from ohmskin.sensing import Percept, Scan, Sensor, SkinModel, build
from ohmskin.skin import Mode

PERIOD = 10e-3  # seconds between frames
PIXELS = 64  # of the images that figures of merit are taken from, along a side
QUIET = 40  # scans of the untouched sheet that a calibration makes of each pattern
_CALIBRATION = 1_000_000  # seed of their noise


@dataclass(frozen=True)
class View:
    """What a sensor made of one frame.

    Args:
        setup: What was measured.
        mode: How.
        percept: What was seen.
        mesh: Mesh of the image.
        raster: Its raster of `PIXELS` pixels.
        image: The image.
        contacts: All contacts that the frame shows, strongest first.
    """

    setup: "Setup" = field(repr=False)
    mode: Mode
    percept: Percept
    mesh: Mesh
    raster: Raster
    image: Image
    contacts: tuple[Contact, ...]

    @property
    def differences(self) -> tuple[Difference, ...]:
        """The data that were read: of all scans of the frame, or of the last one if the mode does not fuse them."""
        return self.setup.differences(self.mode, self.percept)

    @property
    def pixels(self) -> Floats:
        """The image on pixels (ny, nx); NaN off the sheet."""
        return self.raster(self.image.values)

    @property
    def place(self) -> Floats:
        """Where the image is highest (2,) in metres, without a test whether there is a contact: the centroid of the
        part about its peak above half of it; NaN where nothing is positive."""
        values = self.image.values
        peak = float(values.max())
        return find_regions(values, self.mesh, peak / 2)[0].centroid if peak > 0 else np.full(2, np.nan)

    @property
    def strongest(self) -> Floats:
        """Where the strongest contact is that the frame shows (2,) in metres; NaN where it shows none."""
        return np.array(self.contacts[0].position) if self.contacts else np.full(2, np.nan)


class Setup:
    """One world at one noise level, and the estimator's model of it.

    Args:
        world: One of `worlds.WORLDS`.
        decibels: Noise level (dB, see `worlds`).
        amplitude: Prior amplitude s of images (relative conductivity change). With the noise's standard deviation sigma
            in volts it sets lambda = sigma^2 mean(diag R^-1) / s^2, with no model error added, as in the paper, and the
            reference is free of noise. Where it is None, images are made as the skin's description says, and the
            reference is the mean of the quiet scans.
        layout: Electrode layout, of `worlds.LAYOUTS`.
        flaw: Errors of the model.
        assumption: The assumption that differs from the figures of the paper.

    Attributes:
        noise: Standard deviation of a voltage (V).
        known: The calibrated model of the quiet skin: the assumed one, with its conductivity fitted to quiet frames.
    """

    def __init__(
        self,
        world: str,
        decibels: float,
        amplitude: float | None = None,
        layout: str = "grid",
        flaw: Flaw = SOUND,
        assumption: Assumption = STATED,
    ) -> None:
        self.world, self.layout, self.flaw, self._assumption = world, layout, flaw, assumption
        self.noise, skin = worlds.noise_volts(world, decibels), worlds.skin_of(world, layout)
        if amplitude is not None:
            skin = replace(skin, imaging=replace(skin.imaging, amplitude=amplitude, model_error=0.0))
        electrodes, make = assumed_model(layout, flaw)
        self.electrodes, self.skin = electrodes, skin
        rings, complete = electrodes.rings, complete_pattern(electrodes)
        patterns = [adjacent(rings[:1]), adjacent(rings), complete]
        patterns = needed(driven for pattern in patterns for driven in (pattern, pattern.with_driven))
        self._calm = worlds.sheet(world, layout, flaw.wear, assumption.same_mesh).untouched  # at calibration
        scans = [self._device(self._calm, (_CALIBRATION, k)) for k in range(QUIET)]
        log_conductivity = np.zeros(1)
        if flaw.calibrated:
            measured = np.mean([scan(complete).voltages for scan in scans], axis=0) / CURRENT
            if world != "discs":  # which have point electrodes
                electrodes = electrodes.with_discs(skin.discs.extents, skin.discs.contact_impedances)
            noise = self.noise / CURRENT / np.sqrt(QUIET)
            fit = fit_sheet(skin.domain, electrodes, make, complete, measured, noise)
            electrodes, log_conductivity = fit.model.electrodes.with_points(), fit.log_conductivity
        model = make(electrodes, log_conductivity)
        # discs have point electrodes, which have no contact impedance
        impedances = np.zeros(len(model.electrodes)) if world == "discs" else None
        quiet = [scan(pattern) for pattern in patterns for scan in scans]
        self.known = SkinModel(skin, model, quiet, impedances=impedances)
        if amplitude is not None:  # the reference of the paper's study is free of noise
            exact = self._device(self._calm, (), noise=0.0)
            baseline = Baseline.learn([exact(pattern) for pattern in patterns for _ in range(2)])
            self.known.baseline = replace(self.known.baseline, resistances=baseline.resistances)
        self.model, self.electrodes = self.known.model, model.electrodes
        self._sensors: dict[Mode, Sensor] = {}

    def design(self, driven: bool) -> tuple[ContactTable, drives.Candidates]:
        """Input of drives by information: the responses of contacts, and all injections at `CURRENT`.

        Args:
            driven: Whether driven electrodes are measured, too.
        """
        complete, n_elec = complete_pattern(self.electrodes), len(self.electrodes)
        contacts = float(np.mean(self.skin.contact_change(self.known.impedances))) if driven else None
        return self.table, drives.Candidates.at_currents(complete, n_elec, self.noise, CURRENT, contacts)

    @cached_property
    def raster(self) -> Raster:
        """`PIXELS` x `PIXELS` pixels of images."""
        return Raster(self.model.mesh, PIXELS)

    @property
    def table(self) -> ContactTable:
        """Responses of contacts."""
        return self.known.fitter.table

    @cached_property
    def trusting_fitter(self) -> ContactFitter:
        """Fits contacts under a model without errors: for tests whose learned threshold covers them."""
        errors = self.known.fitter.errors
        return ContactFitter(self.table, errors.noise, model_error=0.0, gain=errors.gain, contacts=errors.contacts)

    def drive(self, mode: Mode) -> Drive:
        """The drive of a mode, for the assumed places of the electrodes; fixed patterns are repeated to fill a frame.

        Raises:
            PatternError: If there is none of that name, or not with so many injections.
        """
        settings = DriveSettings(
            self.electrodes, lambda: self.design(mode.driven), self.skin.imaging.pairs, self.skin.domain.period
        )
        drive = DRIVES[mode.drive](settings, 0 if mode.drive in ("rim", "rings") else mode.injections)
        if mode.drive in ("rim", "rings"):
            drive = drives.Fixed(repeated(drive.patterns[0], mode.injections or drive.injections))
        return drives.WithDriven(drive) if mode.driven else drive

    def sensor(self, mode: Mode) -> Sensor:
        """The sensor of a mode; made once."""
        if mode not in self._sensors:
            drive = self.drive(mode)
            middle = drives.Target(self.model.mesh.centroids.mean(axis=0), 1e-6 * np.eye(2), 1e-4, 8e-3)
            drive.next([middle], 1)  # its tables
            self._sensors[mode] = build(mode, self.known, drive)
        return self._sensors[mode]

    def simulate(self, mode: Mode, contacts: Contacts, *seed: int) -> View:
        """The result of a `mode` for one frame under `contacts`, with noise of `seed`, without earlier frames."""
        sensor = self.sensor(mode)
        _, percept = sensor.step(sensor.start(), self.scan(contacts, *seed))
        image, found = percept.image, percept.detections
        if self._assumption.driven:  # which centroids of the loop leave out
            one_step = self.known.one_step(sensor.reader.estimator)
            image = one_step.reconstruct(*self.differences(mode, percept))
            imaging = self.skin.imaging
            finder = ContactFinder(sensor.thresholds.final, imaging.fraction, imaging.dip, imaging.bipolar)
            found = tuple(finder.find(image, self.model.mesh))
        return View(self, mode, percept, self.model.mesh, self.raster, image, found)

    def differences(self, mode: Mode, percept: Percept) -> tuple[Difference, ...]:
        """The data that a `mode` uses of the frames of a `percept`: all of them if it fuses, or the last one."""
        frames = percept.frames if mode.fuse else percept.frames[-1:]
        return tuple(map(self.known.difference, frames))

    def follow(self, mode: Mode, frames: Iterable[Contacts], *seed: int, turn: int = 0) -> Iterator[Percept]:
        """The results of a mode for successive frames.

        Args:
            mode: The mode.
            frames: The contacts of each, `PERIOD` apart.
            seed: Of the noise; frame k has that of ``(*seed, k)``.
            turn: Number of the first scan, at which the cycle of exploring injections starts.
        """
        sensor = self.sensor(mode)
        state = replace(sensor.start(), turn=turn)
        for k, contacts in enumerate(frames):
            state, percept = sensor.step(state, self.scan(contacts, *seed, k, time=PERIOD * k))
            yield percept

    def scan(self, contacts: Contacts, *seed: int, time: float = 0.0) -> Scan:
        """A device that measures the sheet under contacts at `CURRENT`, with noise of its seed, at a time (s)."""
        now = self._calm
        if contacts or self.flaw.since != 1:
            wear, same_mesh = self.flaw.wear * self.flaw.since, self._assumption.same_mesh
            now = worlds.touched(self.world, self.layout, contacts, wear, same_mesh)
        return self._device(now, (*seed, zlib.crc32(repr(contacts).encode())), time)

    def _device(self, resistance: Floats, seed: tuple[int, ...], time: float = 0.0, noise: float | None = None) -> Scan:
        """Measures transfer resistances (n_elec, n_elec) in ohms; with the set-up's noise unless given (V)."""
        sigma = self.noise if noise is None else noise
        driven: Counter[int] = Counter()

        def measure(pattern: DrivePattern) -> Frame:
            random = np.random.default_rng([*seed, pattern.digest, driven[pattern.digest]])  # again: other noise
            driven[pattern.digest] += 1
            flowing, reported = self._currents(resistance, pattern)
            errors = sigma * self._noisy(pattern) * random.standard_normal(pattern.n_meas)
            return Frame(pattern, worlds.voltages(resistance, pattern, flowing) + errors, reported, time)

        return measure

    def _currents(self, resistance: Floats, pattern: DrivePattern) -> tuple[Floats, Floats]:
        """The currents (n_inj,) of a pattern, and those that the device reports (A)."""
        if not self._assumption.source:
            return (given := np.full(pattern.n_inj, CURRENT)), given
        series = self.skin.excitation.resistance + 2 * self.skin.excitation.multiplexer_resistance

        def path(resistance: Floats, pattern: DrivePattern) -> Floats:
            a, b = pattern.injections.T
            return np.asarray(resistance[a, a] + resistance[b, b] - 2 * resistance[a, b] + series)

        volts = CURRENT * float(path(self._calm, adjacent(self.electrodes.rings[:1])).mean())
        flowing = volts / path(resistance, pattern)
        return flowing, flowing if self._assumption.source == "measured" else volts / path(self._calm, pattern)

    def _noisy(self, pattern: DrivePattern) -> Floats:
        """The noise (n_meas,) of a pattern's voltages over that of the set-up (1)."""
        if not self._assumption.noise:
            return np.ones(pattern.n_meas)
        quiet = np.abs(worlds.voltages(self._calm, pattern)) / worlds.full_scale(self.world)
        return quiet if self._assumption.noise == "voltage" else np.full(pattern.n_meas, quiet[~pattern.driven].max())


def repeated(pattern: DrivePattern, injections: int) -> DrivePattern:
    """A pattern driven over and over until there are so many injections; the last round may be a part of it."""
    return drives.part_of(pattern, np.arange(injections) % pattern.n_inj)


setup = lru_cache(maxsize=12)(Setup)  # made once per process for each world, noise and so on
