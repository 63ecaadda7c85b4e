"""Births: new contacts, where one more explains what is left of the last frames significantly better."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from ohmskin.geometry.domain import Floats
from ohmskin.touch.explain import Explainer
from ohmskin.touch.glance import Glance
from ohmskin.touch.likelihood import Data, Misfit, responses
from ohmskin.touch.scene import Scene
from ohmskin.touch.solution import Solution, unknown

_WINDOWS = np.array([1, 2, 3, 4, 6, 8, 12])  # frames over which new contacts are looked for
LONGEST = int(_WINDOWS[-1])


def bar_of_birth(explainer: Explainer) -> float:
    """Standard deviations by which the score of a new contact must stand out, for one false alarm at the stated rate per frame."""
    return float(-ndtri(ndtr(-explainer.bar) / len(_WINDOWS)))


def scored(glance: Glance, explainer: Explainer) -> Glance:
    """A glance with its scores."""
    misfit = Misfit(explainer.noise, glance.unsure)
    score, power = explainer.scores(glance.reading.data, glance.innovation, misfit)
    return replace(glance, score=score, power=power)


def born(scene: Scene, explainer: Explainer, bar: float, common: float, speed: float) -> Scene:
    """The scene with new contacts.

    Args:
        scene: Its glances are scored.
        explainer: What explains data by contacts.
        bar: Standard deviations by which the score of a new contact must stand out.
        common: Share of the noise's variance that is the same in all frames: it does not average out.
        speed: Standard deviation of a contact's velocity (m/s).
    """
    while len(scene.pressing) < explainer.most:
        found, used = _found(scene.glances, explainer, bar, common)
        if found is None:
            break
        covariance = found.covariance
        moved = speed * (scene.time - used[-1].time) / 2
        covariance[[0, 1], [0, 1]] += moved**2
        scene = scene.with_contact(found.params[0], covariance, speed)
        scene = replace(scene, glances=tuple(_reviewed(glance, explainer, found.params) for glance in scene.glances))
    return scene


def _found(glances: Sequence[Glance], explainer: Explainer, bar: float, common: float) -> tuple[Solution | None, Sequence[Glance]]:
    """The contact that stands out most over some of the newest frames, if it does enough, and those frames."""
    windows = _WINDOWS[: np.searchsorted(_WINDOWS, len(glances), side="right")]
    score = np.cumsum([glance.score for glance in glances], axis=0)[windows - 1]
    power = np.cumsum([glance.power for glance in glances], axis=0)[windows - 1]
    energy = np.cumsum([glance.energy for glance in glances])[windows - 1, None]
    shared = 1 + (windows[:, None] - 1) * common
    height = explainer.heights(score, power * shared) - explainer.model_error * np.sqrt(energy) / explainer.noise
    window, place = np.unravel_index(np.argmax(height), height.shape)
    used = glances[: int(windows[window])]
    if height[window, place] < bar:
        return None, used
    data = Data.together([glance.reading.data.less(glance.reading.data.volts - glance.innovation) for glance in used])
    misfit = explainer.misfit(data, block_diag(*[glance.unsure for glance in used]))
    return explainer.added(data, misfit, score[window], power[window]), used


def _reviewed(glance: Glance, explainer: Explainer, params: Floats) -> Glance:
    """A glance after one contact more (1, 4) has been found in it."""
    caused, slopes = responses(explainer.table, glance.reading.data, params)
    free = unknown(slopes, glance.reading.data.volts)
    reviewed = replace(
        glance,
        innovation=glance.innovation - caused,
        residual=glance.residual - caused,
        unsure=np.hstack([free, glance.unsure]),
        energy=glance.energy + float(caused @ caused),
    )
    return scored(reviewed, explainer)
