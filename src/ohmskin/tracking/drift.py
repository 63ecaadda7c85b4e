"""Drift: what changes beside contacts, all resistances together (temperature) or pairs one by one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.likelihood import NoiseModel, no_directions, responses
from ohmskin.contacts.solution import unknown
from ohmskin.scan import Difference
from ohmskin.tracking.motion import Motion
from ohmskin.tracking.residuals import Reading
from ohmskin.tracking.state import TrackState

Unsure = Callable[[Difference], Floats]

_RIDGE = 0.05  # of the rows of a frame, so that drift is not learned where they say nothing


def without_drift(
    state: TrackState, fitter: ContactFitter, difference: Difference, reference: Floats | None, unsure: Unsure | None
) -> Reading:
    """A frame without the drift and the temperature of the state.

    Args:
        state: Whose drift and temperature.
        fitter: What counts how much of the data.
        difference: The frame's change against the untouched skin.
        reference: (n_meas,) voltages of the untouched skin at its currents (V); None where they are not known.
        unsure: Gives the directions (n_meas, k) in which the frame errs beside white noise (V).

    Raises:
        DataError: If no finite datum is left.
    """
    whole = fitter.data(difference)
    known, share = whole.known, whole.share[:, None]
    common = np.zeros(len(whole.volts)) if reference is None else np.asarray(reference, float)[known] * whole.share
    data = whole.less(whole.rows(state.drift) + state.common_drift[0] * common)
    volts = np.full(len(known), np.nan)
    volts[known] = data.volts / whole.share
    errors = no_directions(data) if unsure is None else unsure(difference)[known] * share
    if reference is not None:
        errors = np.hstack([errors, (np.sqrt(state.common_drift[1]) * common)[:, None]])
    return Reading(replace(difference, volts=volts), data, common, errors)


def with_common_drift(state: TrackState, fitter: ContactFitter) -> TrackState:
    """The state with the common change of all resistances that its newest frame shows beside all its contacts."""
    newest = state.history[0]
    common = newest.reading.common
    if not common.any():
        return state
    both = np.column_stack([common, newest.innovation])
    inner = fitter.noise_model(newest.reading.data, newest.unsure[:, :-1]).inner(both, both)
    variance = 1 / (1 / state.common_drift[1] + inner[0, 0])
    rise = float(variance * inner[0, 1])
    newest = replace(newest, residual=newest.residual - rise * common)
    common_drift = (state.common_drift[0] + rise, float(variance))
    return replace(state, common_drift=common_drift, history=(newest, *state.history[1:]))


def learned(state: TrackState, fitter: ContactFitter, motion: Motion, elapsed: float) -> TrackState:
    """The state with part of its newest frame's residual, as much as belongs to a time (s), taken for drift."""
    newest, data = state.history[0], state.history[0].reading.data
    share, left = elapsed / (elapsed + _time(state, motion)), newest.residual
    if state.held:  # what might be a contact's is left to it; what the model gets wrong of a strong one is not learned
        slopes = responses(fitter.table, data, state.params)[1]
        left = NoiseModel(fitter.noise, unknown(slopes, left)).apply(left)
        error = fitter.model_error**2 * newest.energy / len(left)
        share *= fitter.noise**2 / (fitter.noise**2 + error)
    rows = data.matrix
    gram = rows @ rows.T
    gram[np.diag_indices_from(gram)] += _RIDGE
    return replace(state, drift=state.drift + share * (rows.T @ np.linalg.solve(gram, left / data.currents)))


def _time(state: TrackState, motion: Motion) -> float:
    """Over which what no contact explains becomes drift (s): sooner where there are only lifted ones."""
    return motion.settling if state.held and not state.pressing else motion.drifting
