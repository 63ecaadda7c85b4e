"""One cycle of the adaptive loop, compiled: base image, regions, choice (eq. 7), second image, contacts.

The same as its parts in `ohmskin.inverse`, `ohmskin.drive` and `ohmskin.touch`, arranged so that a frame reads its matrices once
and little else. The modes of the image are turned so that the base scan sees each by itself: with its rows H_0 = U diag(s) V^T,
and modes counted along V, the base image needs two products. The second scan then is an update of as many unknowns as it has
voltages, or, in another form of the same, as there are modes if these are fewer,

    u = u_0 + D H^T (I + H D H^T)^-1 (v - H u_0),        D = (s^2 + w^2)^-1,

w the noise over the prior amplitude (fused; otherwise u_0 = 0 and D = 1 / w^2). Solves are in float64, images in float32.
"""

from collections.abc import Callable
from math import erf, sqrt

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.cycle.kernels import Desk, Tables, look, see
from ohmskin.drive import Mode, OptimalDrive, part_of
from ohmskin.errors import DataError, ModelError, PatternError
from ohmskin.forward.tiles import padded
from ohmskin.geometry.domain import Floats
from ohmskin.geometry.mesh import Ints
from ohmskin.inverse import GaussNewton
from ohmskin.scan import Baseline, DrivePattern
from ohmskin.touch import Contact

MOST_CONTACTS = 64
_KEPT_PATTERNS = 1024
Measured = tuple[Floats, Floats]  # voltages (n_meas,) in volts, currents (n_inj,) in amperes


class FastCycle:
    """Sees contacts in an adaptive mode, up to ten thousand times a second. Not for several threads at once: make one for each.

    Args:
        estimator: Of a flat sheet, on its triangles or on pixels.
        mode: An adaptive mode whose choice is eq. (7).
        thresholds: gamma_0 of eq. (6) for the base image and for the final one, see `ohmskin.engine.Thresholds`.
        currents: Current that each injection of the base scan usually has, one value or (n_inj,) (A). Base data are scaled from
            the currents measured to these, so that one factorisation serves all frames.
        baseline: Reference that voltages are compared to; without it `look` and `see` take changes of voltage.
        fraction, dip: See `ohmskin.touch.ContactFinder`.

    Attributes:
        base_image, image: (n_cells,) float32, the newest; overwritten by the next frame.

    Raises:
        ModelError: If the sheet is not flat, or the estimator's images are nowhere negative.
        PatternError: If the mode does not choose by eq. (7), or the baseline has not seen all its patterns.
    """

    def __init__(
        self,
        estimator: GaussNewton,
        mode: Mode,
        thresholds: tuple[float, float],
        currents: float | Floats = 1e-3,
        baseline: Baseline | None = None,
        fraction: float = 0.3,
        dip: float = 0.2,
    ) -> None:
        cells = estimator.cells
        if cells.centroids.shape[1] != 2 or estimator.positive:
            raise ModelError("a fast cycle needs a flat sheet and a linear estimator; see each frame with GaussNewton.reconstruct")
        if not isinstance(mode.optimal, OptimalDrive):
            raise PatternError(f"mode {mode.name} does not choose by eq. (7); a fast cycle needs one that does, such as 16O")
        self.estimator, self.mode, self.thresholds, self.fraction, self.dip = estimator, mode, thresholds, fraction, dip
        modes, base, complete = estimator.modes, mode.base, mode.optimal.complete
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
            quadruples=complete.quadruples.astype(np.int32),
            reference=np.zeros(complete.n_meas) if baseline is None else baseline.reference(complete),
            pairs=complete.injections.copy(),
            electrodes=np.ascontiguousarray(estimator.model.electrodes.positions),
            neighbours=cells.neighbours.astype(np.int32),
            centroids=np.ascontiguousarray(cells.centroids),
            measures=np.ascontiguousarray(cells.measures),
        )
        if not (np.isfinite(self._tables.base_reference).all() and np.isfinite(self._tables.reference).all()):
            raise DataError("some quiet references are not known; a fast cycle needs them all: calibrate again, or use GaussNewton")
        self._per_pair = complete.n_meas // complete.n_inj
        self._n_meas = mode.optimal.pairs * self._per_pair
        n_cells, n_modes = len(cells.measures), len(modes.modes)
        rows, columns = (-(-n // 4) * 4 for n in (self._n_meas, n_modes))  # whole tiles
        size = min(rows, columns)
        self._desk = Desk(
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
            chosen=np.zeros(mode.optimal.pairs, np.int64),
            found=np.zeros((MOST_CONTACTS, 6)),
        )
        self._settings = np.array(
            [
                estimator.noise, estimator.amplitude, estimator.model_error, thresholds[0], thresholds[1], fraction, dip,
                float(mode.fuse), float(squares[:rank].sum()),
            ]
        )  # fmt: skip
        self.base_image, self.image = self._desk.base_image, self._desk.image
        self._looked = False
        self._patterns: dict[bytes, DrivePattern] = {}
        self._warm()

    def look(self, volts: Floats, currents: Floats) -> Ints:
        """The injections (n,) to drive next, numbers of pairs, from the base scan: `volts` (n_meas,) (V), `currents` (n_inj,) (A).

        Raises:
            DataError: If a datum is not finite (leave the frame to `GaussNewton.reconstruct`, which leaves such channels out), or
                there are not as many data as the pattern has.
        """
        self._looked = False
        volts, currents = _checked(volts, len(self._desk.base_volts), currents, len(self._tables.base_currents))
        if look(self._tables, self._desk, self._settings, volts, currents) < 0:
            raise DataError("a voltage or current of the base scan is not finite; use GaussNewton.reconstruct for this frame")
        self._looked = True
        return self._desk.chosen.copy()

    def see(self, volts: Floats, currents: Floats, chosen: ArrayLike | None = None) -> list[Contact]:
        """The contacts, strongest peak first, from the second scan.

        Args:
            volts, currents: As those of `look`.
            chosen: The injections really driven (n,), numbers of pairs, if not those that `look` asked for.

        Raises:
            DataError: As `look`, if that was not called before and is needed, or if a number of `chosen` is out of range.
        """
        if not self._looked and (self.mode.fuse or chosen is None):
            raise DataError("see() completes a cycle that look() begins; call look() with the base scan first")
        volts, currents = _checked(volts, self._n_meas, currents, len(self._desk.chosen))
        if chosen is not None:
            pairs, count = np.asarray(chosen), len(self._tables.pairs)
            if pairs.shape != self._desk.chosen.shape or pairs.dtype.kind not in "iu" or not ((pairs >= 0) & (pairs < count)).all():
                raise DataError(f"chosen must be {len(self._desk.chosen)} numbers of pairs, 0..{count - 1}; given {chosen!r}")
            self._desk.chosen[:] = pairs
        count = see(self._tables, self._desk, self._settings, volts, currents)
        self._looked = False
        if count < 0:
            raise DataError("a voltage or current of the second scan is not finite; use GaussNewton.reconstruct for this frame")
        gamma = self.thresholds[1]
        return [
            Contact((x, y), extent, strength, 0.5 * (1 + erf((peak - gamma) / (sqrt(2) * max(std, 1e-300)))), peak)
            for x, y, extent, strength, peak, std in self._desk.found[:count].tolist()
        ]

    def frame(self, base: Measured, measure: Callable[[Ints], Measured]) -> list[Contact]:
        """A whole cycle: `look` at the base scan, `measure` what it asks for (given numbers of pairs), `see`."""
        return self.see(*measure(self.look(*base)))

    def pattern(self, chosen: Ints) -> DrivePattern:
        """The drive pattern of chosen pairs (n,), to scan; the same object as before if they were chosen before."""
        assert isinstance(self.mode.optimal, OptimalDrive)
        key = chosen.tobytes()
        if key not in self._patterns:
            if len(self._patterns) >= _KEPT_PATTERNS:
                self._patterns.clear()
            self._patterns[key] = part_of(self.mode.optimal.complete, chosen)
        return self._patterns[key]

    def _warm(self) -> None:
        """Compile now, or load what was compiled before; not at the first touch."""
        quiet = self._tables.base_reference * self._tables.base_currents[self._tables.base_injections]
        chosen = self.look(quiet, self._tables.base_currents)
        ones = np.full(len(chosen), float(self._tables.base_currents[0]))
        rows = (chosen[:, None] * self._per_pair + np.arange(self._per_pair)).ravel()
        self.see(self._tables.reference[rows] * ones[0], ones)


def _checked(volts: Floats, n_meas: int, currents: Floats, n_inj: int) -> Measured:
    if np.shape(volts) != (n_meas,) or np.shape(currents) != (n_inj,):
        raise DataError(
            f"voltages and currents have shapes {np.shape(volts)} and {np.shape(currents)}; need ({n_meas},) and ({n_inj},)"
        )
    return np.ascontiguousarray(volts, dtype=float), np.ascontiguousarray(currents, dtype=float)
