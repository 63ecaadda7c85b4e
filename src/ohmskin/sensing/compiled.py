"""The paper's sensor compiled: base image, regions, choice (eq. 7), second image, contacts in two calls.

The same as its parts in `ohmskin.inverse`, `ohmskin.drive` and `ohmskin.contacts`, arranged so that a frame reads its
matrices once and little else. The modes of the image are turned so that the base scan sees each by itself: with its
rows H_0 = U diag(s) V^T, and modes counted along V, the base image needs two products. The second scan then is an
update of as many unknowns as it has voltages, or, in another form of the same, as there are modes if these are fewer,

    u = u_0 + D H^T (I + H D H^T)^-1 (v - H u_0),        D = (s^2 + w^2)^-1,

w the noise over the prior amplitude (fused; otherwise u_0 = 0 and D = 1 / w^2). Solves are float64, images float32.
"""

from collections.abc import Callable
from math import erf, sqrt

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats, Ints, Singles
from ohmskin.contacts import Contact
from ohmskin.drive import OptimalDrive, TwoScans, part_of
from ohmskin.errors import DataError, ModelError, PatternError
from ohmskin.forward.tiles import padded
from ohmskin.inverse import GaussNewton, Image
from ohmskin.inverse.estimators import FrameWise, LazyEstimate
from ohmskin.scan import Baseline, DrivePattern, Frame
from ohmskin.scan.baseline import terms_of
from ohmskin.sensing.kernels import Tables, Workspace, base_step, second_step
from ohmskin.sensing.readers import DetectionReader
from ohmskin.sensing.sensor import Measured, Scan, Sensor
from ohmskin.skin import Mode

MOST_CONTACTS = 64
_KEPT_PATTERNS = 1024
_AGREES = 1e-4  # of the image's maximum: how closely the compiled image must follow the plain one
Data = tuple[Floats, Floats]  # voltages (n_meas,) in volts, currents (n_inj,) in amperes


class CompiledCycle:
    """The drive of eq. (7) read by centroids of Gauss-Newton images, up to 10,000 times a second; one for each thread.

    Args:
        estimator: Of a flat sheet, on its triangles or on pixels.
        drive: Two scans, the second one chosen by eq. (7).
        thresholds: gamma_0 of eq. (6) for the base image and for the final one.
        currents: Current that each injection of the base scan usually has, one value or (n_inj,) (A). Base data are
            scaled from the currents measured to these, so that one factorisation serves all frames.
        baseline: Reference of the voltages; without it, steps take changes of voltage.
        fraction, dip: See `ohmskin.contacts.ContactFinder`.
        fuse: Whether the final image uses the base scan's data as well.

    Attributes:
        base_image, image: (n_cells,) float32, the newest; overwritten by the next frame.

    Raises:
        ModelError: If the sheet is not flat, or the estimator's images are nowhere negative.
        PatternError: If the drive does not choose by eq. (7), or the baseline lacks one of its patterns.
        DataError: If a reference of the baseline is not finite.
    """

    def __init__(
        self,
        estimator: GaussNewton,
        drive: TwoScans,
        thresholds: tuple[float, float],
        currents: float | Floats = 1e-3,
        baseline: Baseline | None = None,
        fraction: float = 0.3,
        dip: float = 0.2,
        fuse: bool = True,
    ) -> None:
        cells = estimator.cells
        if cells.centroids.shape[1] != 2 or cells.period or estimator.positive:
            raise ModelError(
                "a fast cycle needs a flat sheet that is not closed and a linear estimator; use GaussNewton.reconstruct"
            )
        if not isinstance(drive.second, OptimalDrive):
            raise PatternError("the second scan is not chosen by eq. (7); a compiled cycle needs that")
        self.estimator, self.drive, self.thresholds, self.fuse = estimator, drive, thresholds, fuse
        modes, base, complete, pairs = estimator.modes, drive.base, drive.second.complete, drive.second.pairs
        usual = np.array(np.broadcast_to(np.asarray(currents, float), base.n_inj))
        rows = modes.rows(base) * usual[base.measurements[:, 0], None]
        squares, turn = np.linalg.eigh(rows.T @ rows)
        squares, turn = squares[::-1], turn[:, ::-1]
        rank = max(1, int(np.count_nonzero(squares > 1e-14 * squares[0])))
        self._tables = Tables(
            base_columns=np.ascontiguousarray((rows @ turn[:, :rank]).T),
            base_squares=squares[:rank].copy(),
            base_injections=base.measurements[:, 0].copy(),
            base_currents=usual,
            base_reference=np.zeros(base.n_meas) if baseline is None else baseline.reference(base),
            mixing=np.ascontiguousarray(modes.mixing @ turn),
            modes=np.ascontiguousarray(turn.T @ modes.modes, dtype=np.float32),
            terms=terms_of(complete, modes.pairs)[:4].T.astype(np.int32),
            reference=np.zeros(complete.n_meas) if baseline is None else baseline.reference(complete),
            pairs=complete.injections.copy(),
            reach=drive.second.reach,
            electrodes=np.ascontiguousarray(estimator.model.electrodes.positions),
            neighbours=cells.neighbours.astype(np.int32),
            centroids=np.ascontiguousarray(cells.centroids),
            measures=np.ascontiguousarray(cells.measures),
        )
        if not (np.isfinite(self._tables.base_reference).all() and np.isfinite(self._tables.reference).all()):
            raise DataError("a fast cycle needs every quiet reference; calibrate again, or use GaussNewton")
        self._per_pair = complete.n_meas // complete.n_inj
        self._n_meas = pairs * self._per_pair
        n_cells, n_modes = len(cells.measures), len(modes.modes)
        rows, columns = (-(-n // 4) * 4 for n in (self._n_meas, n_modes))  # whole tiles
        size = min(rows, columns)
        self._space = Workspace(
            base_image=np.zeros(n_cells, np.float32),
            image=np.zeros(n_cells, np.float32),
            base_volts=np.zeros(base.n_meas),
            projected=np.zeros(rank),
            u_single=np.zeros(n_modes, np.float32),
            root=np.zeros(n_modes),
            z=np.zeros(n_modes),
            scaled=np.zeros(rows * padded(columns)),
            turned=np.zeros(columns * padded(rows) if rows <= columns else 0),
            system=np.zeros(size * padded(size)),
            residual=np.zeros(self._n_meas),
            solved=np.zeros(size * 8),
            own=np.zeros(columns * 8),
            seen=np.zeros(rows * 8),
            sizes=np.array([rows, columns]),
            keys=np.zeros(n_cells, np.int64),
            parent=np.full(n_cells, -1, np.int32),
            labels=np.full(n_cells, -1, np.int32),
            regions=np.zeros((MOST_CONTACTS, 6)),
            anchors=np.zeros((MOST_CONTACTS, 3, 2)),
            crossed=np.zeros((MOST_CONTACTS, len(complete.injections))),
            chosen=np.zeros(pairs, np.int64),
            found=np.zeros((MOST_CONTACTS, 6)),
        )
        prior = (estimator.noise, estimator.amplitude, estimator.model_error)
        self._settings = np.array([*prior, *thresholds, fraction, dip, float(fuse), float(squares[:rank].sum())])
        self.base_image, self.image = self._space.base_image, self._space.image
        self._has_base = False
        self._patterns: dict[bytes, DrivePattern] = {}

    def base_step(self, volts: Floats, currents: Floats) -> Ints:
        """The pairs (n,) to drive next, by number, from the base scan: `volts` (n_meas,) (V), `currents` (n_inj,) (A).

        Raises:
            DataError: If a datum is not finite (leave the frame to `GaussNewton.reconstruct`, which leaves such
                channels out), or there are not as many data as the pattern has.
        """
        self._has_base = False
        volts, currents = _checked(volts, len(self._space.base_volts), currents, len(self._tables.base_currents))
        if base_step(self._tables, self._space, self._settings, volts, currents) < 0:
            raise DataError("a voltage or current of the base scan is not finite; use GaussNewton.reconstruct")
        self._has_base = True
        return self._space.chosen.copy()

    def second_step(self, volts: Floats, currents: Floats, chosen: ArrayLike | None = None) -> list[Contact]:
        """The contacts, strongest peak first, from the second scan.

        Args:
            volts, currents: As those of `base_step`.
            chosen: The injections really driven (n,), numbers of pairs, if not those that `base_step` asked for.

        Raises:
            DataError: As `base_step`; if `base_step` is needed and was not called; or if a number of `chosen` is out of
                range.
        """
        if not self._has_base and (self.fuse or chosen is None):
            raise DataError(
                "second_step() completes a cycle that base_step() begins; call base_step() with the base scan first"
            )
        volts, currents = _checked(volts, self._n_meas, currents, len(self._space.chosen))
        if chosen is not None:
            pairs, count = np.asarray(chosen), len(self._tables.pairs)
            fits = pairs.shape == self._space.chosen.shape and pairs.dtype.kind in "iu"
            if not (fits and ((pairs >= 0) & (pairs < count)).all()):
                raise DataError(f"chosen must be {len(self._space.chosen)} pairs, 0..{count - 1}; given {chosen!r}")
            self._space.chosen[:] = pairs
        count = second_step(self._tables, self._space, self._settings, volts, currents)
        self._has_base = False
        if count < 0:
            raise DataError("a voltage or current of the second scan is not finite; use GaussNewton.reconstruct")
        gamma = self.thresholds[1]
        return [
            Contact((x, y), extent, strength, 0.5 * (1 + erf((peak - gamma) / (sqrt(2) * max(std, 1e-300)))), peak)
            for x, y, extent, strength, peak, std in self._space.found[:count].tolist()
        ]

    def frame(self, base: Data, measure: Callable[[Ints], Data]) -> list[Contact]:
        """A whole cycle: `base_step` at the base scan, measure what it asks for, `second_step`.

        Args:
            base: Voltages (n_meas,) (V) and currents (n_inj,) (A) of the base scan.
            measure: Called with the numbers (n,) of the pairs to drive; returns the same of the second scan.

        Raises:
            DataError: As `base_step` and `second_step`.
        """
        return self.second_step(*measure(self.base_step(*base)))

    def pattern(self, chosen: Ints) -> DrivePattern:
        """The drive pattern of chosen pairs (n,); the same object for the same pairs."""
        key = chosen.tobytes()
        if key not in self._patterns:
            if len(self._patterns) >= _KEPT_PATTERNS:
                self._patterns.clear()
            self._patterns[key] = part_of(self.drive.second.complete, chosen)
        return self._patterns[key]


def _checked(volts: Floats, n_meas: int, currents: Floats, n_inj: int) -> Data:
    if np.shape(volts) != (n_meas,) or np.shape(currents) != (n_inj,):
        given = f"voltages and currents have shapes {np.shape(volts)} and {np.shape(currents)}"
        raise DataError(f"{given}; need ({n_meas},) and ({n_inj},)")
    return np.ascontiguousarray(volts, dtype=float), np.ascontiguousarray(currents, dtype=float)


class Compiled:
    """The compiled cycle as an implementation of a sensor.

    Args:
        sensor: Drives by eq. (7) and reads centroids.
        cycle: The same, compiled.
    """

    def __init__(self, sensor: Sensor, cycle: CompiledCycle, reader: DetectionReader) -> None:
        self._sensor, self._cycle, self._reader = sensor, cycle, reader

    def measure(self, scan: Scan) -> Measured | tuple[Frame, ...]:
        """A frame measured and read; the scans made so far if a value is missing or another pattern was driven."""
        cycle, known, frames = self._cycle, self._sensor.known, []

        def checked(pattern: DrivePattern) -> Data:
            frames.append(scan(pattern))
            if frames[-1].pattern != pattern:  # a recording has what was driven then
                raise DataError("another pattern was driven than was asked for")
            if not known.soundness(frames[-1]).whole:
                raise DataError("a voltage is missing, clips, or has no current behind it")
            return frames[-1].voltages, frames[-1].currents

        try:
            chosen = cycle.base_step(*checked(cycle.drive.base))
            found = cycle.second_step(*checked(cycle.pattern(chosen)))
        except DataError:
            return tuple(frames)

        def image(values: Singles, *used: Frame) -> LazyEstimate:
            def noise_std(cells: ArrayLike) -> Floats:
                return cycle.estimator.reconstruct(*map(known.difference, used)).noise_std(cells)

            kept = values.astype(float)  # the next cycle writes over them
            return LazyEstimate(lambda: Image(kept, noise_std, shares=cycle.estimator.shares))

        base_estimate = image(cycle.base_image, frames[0])
        estimate = image(cycle.image, *frames[0 if cycle.fuse else 1 :])
        scans = tuple(map(known.difference, frames))
        return Measured(
            tuple(frames), scans, base_estimate, lambda before: self._reader.follow(before, estimate, found)
        )


def compiled(sensor: Sensor, mode: Mode) -> Compiled | None:
    """The compiled cycle of a sensor; None where there is none, or where its images are not those of the plain way."""
    known, drive, reader, imaging = sensor.known, sensor.drive, sensor.reader, sensor.known.skin.imaging
    estimator = reader.estimator
    if mode.reader != "centroid" or not isinstance(reader, DetectionReader) or not isinstance(drive, TwoScans):
        return None
    if not isinstance(estimator, FrameWise) or estimator.estimator is not sensor.locator.estimator:
        return None
    if not isinstance(drive.second, OptimalDrive) or known.weighs or imaging.bipolar:
        return None
    gammas = sensor.thresholds.base, sensor.thresholds.final
    currents = known.usual_currents(drive.base)
    if currents is None:
        return None
    try:
        known_quiet = (gammas, currents, known.baseline)
        cycle = CompiledCycle(sensor.locator.estimator, drive, *known_quiet, imaging.fraction, imaging.dip, sensor.fuse)
    except (DataError, ModelError):  # not all of it was seen while the skin was quiet, or the sheet is not flat
        return None
    implementation = Compiled(sensor, cycle, reader)
    return implementation if _agrees(sensor, implementation) else None


def _agrees(sensor: Sensor, implementation: Compiled) -> bool:
    """Whether both ways image a simulated contact in the middle of the sheet alike."""
    scan = sensor.known.pressed(sensor.known.model.mesh.centroids.mean(axis=0)[None])
    found, plain = implementation.measure(scan), sensor.measure(sensor.start(), scan)
    if (
        not isinstance(found, Measured)
        or found.read is None
        or found.base_estimate is None
        or plain.base_estimate is None
    ):
        return False
    start = sensor.start().belief
    scans = plain.scans if sensor.fuse else plain.scans[-1:]
    read = sensor.reader.update(start, scans, scans, 0.0)
    images = [(found.base_estimate.image, plain.base_estimate.image), (found.read(start).image, read.image)]
    return all(np.abs(a.values - b.values).max() <= _AGREES * np.abs(b.values).max() for a, b in images)
