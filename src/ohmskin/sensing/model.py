"""What is learned of a quiet skin, and the parts that every reader of it shares."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ohmskin.arrays import Floats, changed
from ohmskin.contacts import ContactFitter
from ohmskin.contacts.uneven import field_changes
from ohmskin.errors import DataError, ModelError
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.inverse import GaussNewton
from ohmskin.inverse.estimators import ESTIMATORS, Estimator, EstimatorSettings, FrameWise
from ohmskin.scan import Baseline, Difference, DrivePattern, Frame, Pairs, Quality
from ohmskin.scan.pairs import in_series, pairs_measured
from ohmskin.sensing.quiet import QuietScans
from ohmskin.sensing.soundness import Soundness, judged
from ohmskin.skin import PressedSheet, Skin

_LEAST_NOISE = 1e-4  # of the largest voltage: noise-free recordings exist, and the problem must stay well posed
_FINER = 0.8  # edges of the mesh over the estimator's: those resolve a press near the rim to 1.5 %, these to 0.5 %
_RECENT = 4  # frames whose soundness is remembered
_BY_CHANCE = 3  # largest values that may be the same
_UNLIKE = 20.0  # noises by which those of the quiet skin must differ


class SkinModel:
    """A skin, and what its quiet frames give: reference data, noise, and the forward model that fits them.

    Args:
        skin: Its description.
        model: Forward model of the untouched sheet as described; its conductivity is scaled to the quiet frames.
        quiet: Frames of the untouched skin, of every pattern that will be driven.
        quality: Which electrodes to leave out or to give a lower weight, by `ohmskin.scan.assess`; all have the same
            weight unless given.
        impedances: (n_elec,) contact impedances (ohm); estimated from quiet voltages of driven electrodes unless given.

    Attributes:
        baseline: Reference data and noise.
        model: The model, scaled.
        noise: Standard deviation of a difference of voltages (V).
        white: The same without what voltages of one injection share.
        gain: Standard deviation of the relative error of a measured current (1).
        channels, positions: Gains and errors of channels, and the position map, from the skin's calibration; None if it
            has none.
        quiet: The quiet frames, from which any pattern can be assembled.
        pairs: The pairs of electrodes by whose two-terminal resistances all data are explained.

    Raises:
        DataError: If the quiet frames give no reference.
    """

    def __init__(
        self,
        skin: Skin,
        model: TransferModel,
        quiet: Sequence[Frame],
        quality: Quality | None = None,
        impedances: Floats | None = None,
    ) -> None:
        self.skin, self.quality, self._impedances = skin, quality, impedances
        if quality is not None:
            quiet = [quality.clean(frame) for frame in quiet]
        self.channels, self.positions = skin.calibration.judged, skin.calibration.positions_learned
        if self.channels is not None:
            quiet = [self.channels.clean(frame) for frame in quiet]
        self.baseline, self.quiet = Baseline.learn(quiet), QuietScans(quiet)
        self._first = quiet[0].pattern
        self.pairs = _covering(model.pairs, [frame.pattern for frame in quiet])
        self._described = model.over(self.pairs)
        self._table_scale = self._scale(model)
        self.model = self._described.scaled(self._table_scale)
        volts = quiet[0].voltages[~self._first.driven | self._first.driven.all()]
        floor = _LEAST_NOISE * float(np.nanmax(np.where(np.isfinite(volts), np.abs(volts), 0.0)))
        self.noise = max(self.baseline.difference_noise, floor)
        white, self.gain = kinds_of_noise(self.baseline, quiet)
        exact = not self.baseline.difference_noise  # without noise: floored
        self.white = self.noise if exact else white * max(self.noise / self.baseline.difference_noise, 1.0)
        n_elec = len(skin.electrodes)
        self._usual = np.full((n_elec, n_elec), np.nan)  # currents (A) of the pairs driven
        for frame in quiet:
            measured = np.isfinite(frame.currents) & (frame.currents != 0)
            measured &= ~np.isin(frame.pattern.injections, self.bad).any(axis=1)
            self._usual[tuple(frame.pattern.injections[measured].T)] = frame.currents[measured]
        self._judged: tuple[tuple[Frame, Soundness], ...] = ()
        self._estimators: dict[tuple[str, str, str], Estimator] = {}

    @property
    def bad(self) -> tuple[int, ...]:
        """Electrodes that were left out on the quiet skin."""
        return () if self.quality is None else self.quality.bad

    def difference(self, frame: Frame) -> Difference:
        """The change of a frame's voltages against the untouched skin, doubtful electrodes left out or of lower weight.

        The same applies to impossible values: of injections whose current does not flow, and at the end of the
        converter's range.
        """
        flowing, sound, _, whole = self.soundness(frame)
        if not whole:
            currents = np.where(flowing, frame.currents, np.nan)
            frame = replace(frame, voltages=np.where(sound, frame.voltages, np.nan), currents=currents)
        if self.quality is None:
            difference = self.baseline.difference(frame)
        else:
            difference = self.quality.weigh(self.baseline.difference(self.quality.clean(frame)))
        return difference if self.channels is None else self.channels.weigh(difference, self.noise)

    @property
    def weighs(self) -> bool:
        """Whether some data have a lower weight than others."""
        return self.quality is not None or self.channels is not None

    def soundness(self, frame: Frame) -> Soundness:
        """Which values of a `frame` are possible.

        Currents are if they are a tenth to ten times those on the quiet
        skin; voltages are if their current is and they are not clipped. Values count as clipped if they all equal the
        largest one, to the last bit, although on the quiet skin they do not.
        """
        for recent, known in self._judged:
            if recent is frame:
                return known
        pattern, (volts, currents) = frame.pattern, (frame.voltages, frame.currents)
        flowing, sound, flow, whole, alike = judged(
            currents, volts, pattern.injections, pattern.injection_numbers, self._usual
        )
        known = Soundness(flowing, sound, flow, whole)
        if alike > _BY_CHANCE or self.bad:
            if alike > _BY_CHANCE:
                sizes = np.where(sound, np.abs(volts), -1.0)
                largest = np.flatnonzero(sizes == sizes.max())
                usual = np.abs(self.baseline.reference(pattern) * frame.measurement_currents)[largest]
                sound[largest] = np.ptp(usual) < _UNLIKE * self.noise
            if self.bad:  # what they take part in is left out anyhow
                flowing |= np.isin(pattern.injections, self.bad).any(axis=1)
                sound |= pattern.uses(self.bad)
            known = Soundness(flowing, sound, bool(flowing.all()), bool(sound.all()))
        self._judged = ((frame, known), *self._judged[: _RECENT - 1])  # a new one: threads may read the old
        return known

    def usual_currents(self, pattern: DrivePattern) -> Floats | None:
        """The currents (n_inj,) of a pattern on the quiet skin (A); None if not all were measured."""
        currents: Floats = self._usual[tuple(pattern.injections.T)]
        return None if np.isnan(currents).any() else currents

    def at_usual_currents(self, difference: Difference) -> Difference:
        """A difference scaled to the currents of the quiet skin, so that one factorisation serves all frames of a base
        scan."""
        usual = self.usual_currents(difference.pattern)
        if usual is None or self.weighs:  # which counts less what has less current
            return difference
        wanted = usual[difference.pattern.injection_numbers]
        with np.errstate(divide="ignore", invalid="ignore"):
            return changed(difference.times(wanted / difference.currents), currents=wanted)

    def pressed(self, places: Floats) -> Callable[[DrivePattern], Frame]:
        """Scans without noise of a sheet that is touched at places (n, 2 or 3), by linear theory.

        At each place the
        conductivity of eight elements is 50 % higher.
        """
        model = self.model
        touched = np.unique(model.mesh.closest_elements(places, 8))
        shares = sp.csc_array((model.conductivity[touched], (touched, 0 * touched)), shape=(model.mesh.n_elem, 1))
        change = 0.5 * model.grouped_sensitivity(shares)[:, 0]

        def scan(pattern: DrivePattern) -> Frame:
            frame = self.quiet.scan(pattern, 0)
            volts = frame.voltages + frame.measurement_currents * (pattern.combination(model.pairs) @ change)
            return replace(frame, voltages=volts)

        return scan

    def estimator(self, name: str, prior: str = "paper", rule: str = "physical") -> Estimator:
        """The estimator of that `name`, with that `prior` and `rule` (`ESTIMATORS`, `PRIORS`, `RULES`); made once.

        Raises:
            ModelError: If there is no such estimator, prior or rule, or it does not fit the skin.
        """
        key = name, prior, rule
        if key not in self._estimators:
            imaging = self.skin.imaging
            settings = EstimatorSettings(
                self.model, self.noise, prior, rule, imaging.amplitude, imaging.model_error, imaging.bipolar
            )
            self._estimators[key] = ESTIMATORS[name](settings)
        return self._estimators[key]

    def one_step(self, estimator: Estimator) -> GaussNewton:
        """The estimator for base scans: `estimator` if it is one-step Gauss-Newton, else that with the paper's prior.

        Raises:
            ModelError: If a package has replaced the estimator `gauss-newton`.
        """
        for found in (estimator, self.estimator("gauss-newton")):
            if (
                isinstance(found, FrameWise)
                and isinstance(found.estimator, GaussNewton)
                and not found.estimator.positive
            ):
                return found.estimator
        raise ModelError("the estimator 'gauss-newton' was replaced; base scans need it")

    @cached_property
    def fitter(self) -> ContactFitter:
        """Fits contacts to data; made when it is first needed, in about a second.

        Raises:
            ModelError: If the sheet is not flat.
        """
        return ContactFitter(
            self._table,
            self.white,
            self.skin.imaging.contact_error,
            bipolar=self.skin.imaging.bipolar,
            gain=self.gain,
            contacts=self.contact_changes,
            fields=field_changes(self.electrode_model() if self.impedances.any() else self.model, self.skin.domain),
        )

    @cached_property
    def _table(self) -> ContactTable:
        """The responses of contacts, with electrodes of their real size: a point's is singular under a contact.

        Where there are no contact impedances, electrodes are points.
        """
        model, scale = self._described, self._table_scale
        if self.impedances.any() and model.mesh.nodes.shape[1] == 2 and not model.electrodes.are_areas.any():
            model = self._of_real_size(model)
            scale = self._scale(model)
        return self.skin.contact_table(model).scaled(scale)

    def _of_real_size(self, model: TransferModel) -> TransferModel:
        """A model with point electrodes as one with discs, on a mesh that resolves them."""
        if model is self.skin.transfer_model():
            return self.skin.electrode_model()
        discs = self.skin.discs
        electrodes = model.electrodes.with_discs(discs.extents, discs.contact_impedances)
        mesh = self.skin.mesh_for(electrodes)
        values = model.tensors[model.mesh.closest_elements(mesh.centroids, 1).ravel()]
        return TransferModel(mesh, electrodes, values).over(self.pairs)

    @cached_property
    def contact_changes(self) -> Floats:
        """Change of two-terminal resistances (n_pairs, n_elec) with a standard deviation of each contact (ohm).

        Idle electrodes shunt the sheet, so that undriven voltages depend on their contacts, too. Without contact
        impedances electrodes are points, and a change is a resistance in series with them.
        """
        change = self.skin.contact_change(self.impedances)
        if not self.impedances.any():
            return in_series(range(len(change)), self.pairs) * change
        model = self.electrode_model()
        return model.pair_contact_sensitivity * model.electrode_extents * change

    @cached_property
    def impedances(self) -> Floats:
        """Contact impedances (n_elec,) of the electrodes (ohm); those of the description where they were not measured.

        Each is the difference between a driven electrode's quiet voltage and that of a perfect contact of its size in
        the model.
        """
        if self._impedances is not None:
            return self._impedances
        model = self._perfect
        described, quiet = self.skin.discs.contact_impedances / model.electrode_extents, self.quiet.driven
        if calibrated := self.skin.calibration.contact_impedances:
            return np.fmax(calibrated, described)
        if quiet is None:
            return described
        found = described.copy()
        excess = (self.baseline.reference(quiet) - model.voltages(quiet))[quiet.driven]
        source, sink, plus, minus = quiet.quadruples[quiet.driven].T
        electrodes = np.where((plus == source) | (minus == source), source, sink)
        excess *= np.where((plus == source) | (minus == sink), 1.0, -1.0)
        for number in np.unique(electrodes):
            own = excess[electrodes == number]
            found[number] += np.median(own[np.isfinite(own)]) if np.isfinite(own).any() else 0.0
        return np.asarray(np.fmax(found, described))

    def electrode_model(self, finer: float = 1.0) -> TransferModel:
        """The skin with electrodes of real size and their `impedances`, scaled to the quiet frames.

        `finer`: edges of its mesh over the estimator's.
        """
        model = self._perfect if finer == 1 else self._scaled(self.skin.electrode_model(finer).over(self.pairs))
        return model.with_contact_impedances(model.electrode_extents * self.impedances)

    @cached_property
    def pressed_sheet(self) -> PressedSheet:
        """The skin as measured by its quiet frames, under its layer as described; made when it is first needed."""
        return PressedSheet(self.skin, model=self.electrode_model(_FINER))

    @cached_property
    def _perfect(self) -> TransferModel:
        """The same with contacts as described; points and discs differ in what scale they want."""
        return self._scaled(self.skin.electrode_model().over(self.pairs))

    def _scaled(self, model: TransferModel) -> TransferModel:
        return model.with_conductivity(model.conductivity * self._scale(model))

    def _scale(self, model: TransferModel) -> float:
        """By what a model's conductivity must be multiplied to have the quiet voltages of idle electrodes (1)."""
        modelled, measured = model.voltages(self._first), self.baseline.reference(self._first)
        known = np.isfinite(measured) & (~self._first.driven | self._first.driven.all())
        if not known.any():
            raise DataError("no quiet voltage is known; check the device, or which electrodes were left out")
        alike = float(modelled[known] @ measured[known])
        if alike <= 0:
            what = "the quiet voltages do not agree with the model's, or have the wrong sign"
            raise DataError(f"{what}; check the drive pattern, the wires, and which skin it is")
        return float(modelled[known] @ modelled[known] / alike)


def _covering(pairs: Pairs, patterns: Sequence[DrivePattern]) -> Pairs:
    """The pairs, or those behind patterns that need others."""
    quadruples = [pattern.quadruples for pattern in dict.fromkeys(patterns)]
    if all(pairs.covers(each) for each in quadruples):
        return pairs
    return pairs_measured(pairs.n_elec, quadruples)


def kinds_of_noise(baseline: Baseline, quiet: Sequence[Frame]) -> tuple[float, float]:
    """White noise of a difference (V), and the relative error of a measured current that all voltages of an injection
    share (1)."""
    count, white, along, squares, injections = 0, 0.0, 0.0, 0.0, 0
    for frame in quiet if baseline.repeats > 1 else ():
        difference = baseline.difference(frame)
        reference = difference.currents * baseline.reference(frame.pattern)
        known = np.isfinite(difference.volts) & np.isfinite(reference)
        which = frame.pattern.measurements[known, 0]
        u, r = reference[known], difference.volts[known]
        uu, ur, rr = (np.bincount(which, product, frame.pattern.n_inj) for product in (u * u, u * r, r * r))
        measured = np.bincount(which, minlength=frame.pattern.n_inj)
        used = (measured > 1) & (uu > 0)
        share = ur[used] ** 2 / uu[used]
        count += int(measured[used].sum())
        white, along = white + float((rr[used] - share).sum()), along + float(share.sum())
        squares, injections = squares + float(uu[used].sum()), injections + int(used.sum())
    if count <= injections or white <= 0:
        return baseline.difference_noise, 0.0
    # the quiet frames' own mean is taken off; a later frame's is not
    bias = (1 + 1 / baseline.repeats) / (1 - 1 / baseline.repeats)
    variance = white / (count - injections)
    gain = max(along / injections - variance, 0.0) / (squares / injections)
    return float(np.sqrt(variance * bias)), float(np.sqrt(gain * bias))
