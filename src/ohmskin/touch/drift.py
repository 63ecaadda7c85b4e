"""Drift: what else changes in the baseline beside contacts, all resistances together (temperature) or pairs one by one."""

from dataclasses import replace

import numpy as np

from ohmskin.geometry.domain import Floats
from ohmskin.scan import Difference
from ohmskin.touch.explain import Explainer
from ohmskin.touch.glance import Reading
from ohmskin.touch.likelihood import Data, Misfit, gain_directions, no_directions, responses
from ohmskin.touch.motion import Motion
from ohmskin.touch.scene import Scene
from ohmskin.touch.solution import unknown

_RIDGE = 0.05  # of the rows of a frame, so that drift is not learned where they say nothing


def taken_off(scene: Scene, n_elec: int, difference: Difference, reference: Floats | None, gain: float) -> Reading:
    """A frame without the drift and the temperature of the scene.

    Args:
        scene: Whose drift and temperature.
        n_elec: Number of electrodes.
        difference: The frame's change against the untouched skin.
        reference: (n_meas,) voltages of the untouched skin at its currents (V); None where they are not known.
        gain: Standard deviation of the error of a measured current (1).

    Raises:
        DataError: If no finite datum is left.
    """
    whole = Data.of(n_elec, difference)
    known = whole.known
    warm = np.zeros(len(whole.volts)) if reference is None else np.asarray(reference, float)[known]
    data = whole.less(whole.rows(scene.drift) + scene.warmth[0] * warm)
    volts = np.full(len(known), np.nan)
    volts[known] = data.volts
    errors = no_directions(data)
    if reference is not None:
        errors = (np.sqrt(scene.warmth[1]) * warm)[:, None]
        if gain:
            errors = np.hstack([gain_directions(difference, np.asarray(reference, float), gain)[known], errors])
    return Reading(replace(difference, volts=volts), data, warm, errors)


def warmed(scene: Scene, explainer: Explainer) -> Scene:
    """The scene with the common change of all resistances that its newest frame shows beside its contacts, new ones included."""
    newest = scene.glances[0]
    warm = newest.reading.warm
    if not warm.any():
        return scene
    both = np.column_stack([warm, newest.innovation])
    inner = explainer.misfit(newest.reading.data, newest.unsure[:, :-1]).inner(both, both)
    variance = 1 / (1 / scene.warmth[1] + inner[0, 0])
    rise = float(variance * inner[0, 1])
    newest = replace(newest, residual=newest.residual - rise * warm)
    return replace(scene, warmth=(scene.warmth[0] + rise, float(variance)), glances=(newest, *scene.glances[1:]))


def learned(scene: Scene, explainer: Explainer, motion: Motion, elapsed: float) -> Scene:
    """The scene with some of what no contact explains of its newest frame taken for drift: as much as belongs to a time (s)."""
    newest, data = scene.glances[0], scene.glances[0].reading.data
    share, left = elapsed / (elapsed + _time(scene, motion)), newest.residual
    if len(scene.held):  # what might be a contact's is left to it, and what the model gets wrong of a strong one is not learned
        slopes = responses(explainer.table, data, scene.params)[1]
        left = Misfit(explainer.noise, unknown(slopes, left)).apply(left)
        error = explainer.model_error**2 * newest.energy / len(left)
        share *= explainer.noise**2 / (explainer.noise**2 + error)
    rows = data.matrix
    gram = rows @ rows.T
    gram[np.diag_indices_from(gram)] += _RIDGE
    return replace(scene, drift=scene.drift + share * (rows.T @ np.linalg.solve(gram, left / data.currents)))


def _time(scene: Scene, motion: Motion) -> float:
    """Over which what no contact explains becomes drift (s): sooner where there are only lifted ones."""
    return motion.settling if scene.held and not scene.pressing else motion.drifting
