"""Revisions: a contact is moved elsewhere, two are taken for one, or one for two, where the last frames say so."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from ohmskin.geometry.domain import Floats
from ohmskin.touch.explain import Explainer
from ohmskin.touch.likelihood import PER_CONTACT, Data, Misfit, responses
from ohmskin.touch.scene import STATE, Scene

_TRIALS = 1e3  # looks at whether one contact is two over which `false_twos` holds
NEAR = 4.0  # radii, within which two contacts may be one
_ELSEWHERE = 6.0  # squared misfit by which another place must be better for a contact that has just come
_HYSTERESIS = 0.5  # share of the bar of a split below which two contacts become one again


def bar_of_revision(explainer: Explainer) -> float:
    """By how much two contacts must explain the last frames better than one, if they are looked at again and again."""
    return explainer.bar_of_split(explainer.false_twos / _TRIALS)


def revised(scene: Scene, explainer: Explainer, bar: float, speed: float, turn: int) -> Scene:
    """The scene after one revision at most.

    Args:
        scene: With at least one glance.
        explainer: What explains data by contacts.
        bar: By how much two contacts must explain the last frames better than one.
        speed: Standard deviation of a contact's velocity (m/s).
        turn: Which contact's turn it is to be looked at for two, counted on from one revision to the next.
    """
    pressing = scene.pressing
    for k in pressing:
        young = scene.held[k].since >= scene.glances[-1].time  # its first frame may have misled
        if young and (placed := _placed(scene, explainer, speed, k)) is not None:
            return placed
    for place, k in enumerate(pressing):
        for other in pressing[place + 1 :]:
            apart = float(np.linalg.norm(scene.mean[k, :2] - scene.mean[other, :2]))
            near = apart < NEAR * explainer.table.radius
            if near and (merged := _merged(scene, explainer, bar, speed, (k, other))) is not None:
                return merged
    if pressing and len(pressing) < explainer.most:
        return _split(scene, explainer, bar, speed, pressing[turn % len(pressing)])
    return scene


def _placed(scene: Scene, explainer: Explainer, speed: float, k: int) -> Scene | None:
    """The scene with one contact where the frames since it came want it, if that is elsewhere."""
    data, errors = _resting(scene, explainer, [k])
    misfit = explainer.misfit(data, errors)
    here = explainer.refine(data, scene.params[[k]], misfit)
    there = explainer.added(data, misfit, *explainer.scores(data, data.volts, Misfit(explainer.noise, errors)))
    if here.cost - there.cost < _ELSEWHERE:
        return None
    mean, covariance = scene.mean.copy(), scene.covariance.copy()
    at = slice(STATE * k, STATE * (k + 1))
    mean[k, :PER_CONTACT], mean[k, PER_CONTACT:] = there.params[0], 0.0
    covariance[at], covariance[:, at] = 0.0, 0.0
    covariance[at, at] = block_diag(there.covariance, speed**2 * np.eye(2))
    return replace(scene, mean=mean, covariance=covariance, glances=())


def _split(scene: Scene, explainer: Explainer, bar: float, speed: float, k: int) -> Scene:
    """The scene with one contact as two, if these explain the last frames better; the closer one keeps the name."""
    data, errors = _resting(scene, explainer, [k])
    one = explainer.refine(data, scene.params[[k]], explainer.misfit(data, errors))
    two = explainer.split(data, one, 0, bar, errors)
    if two is None:
        return scene
    closer, farther = np.argsort(np.linalg.norm(two.params[:, :2] - scene.mean[k, :2], axis=1))
    rest, covariances = scene.without([k]), two.covariances
    kept = rest.with_contact(two.params[closer], covariances[closer], speed, scene.held[k].id)
    return replace(kept.with_contact(two.params[farther], covariances[farther], speed), glances=())


def _merged(scene: Scene, explainer: Explainer, bar: float, speed: float, both: tuple[int, int]) -> Scene | None:
    """The scene with two contacts as one, if one explains the last frames nearly as well; it keeps the older name."""
    data, errors = _resting(scene, explainer, both)
    misfit = explainer.misfit(data, errors)
    pair = scene.params[list(both)]
    weight = np.abs(pair[:, 2]) / np.abs(pair[:, 2]).sum()
    start = weight @ pair
    start[2] = pair[:, 2].sum()
    two, one = explainer.refine(data, pair, misfit), explainer.refine(data, start[None], misfit)
    if explainer.gained(data, one, two) > _HYSTERESIS * bar:
        return None
    kept = min(scene.held[k].id for k in both)
    return replace(scene.without(both).with_contact(one.params[0], one.covariance, speed, kept), glances=())


def _resting(scene: Scene, explainer: Explainer, chosen: Sequence[int]) -> tuple[Data, Floats]:
    """The newest frames in which the chosen contacts rested, as if only these were there, and directions in which they err (V)."""
    chosen = list(chosen)
    speed = float(np.linalg.norm(scene.mean[chosen, PER_CONTACT:], axis=1).max())
    came = max(scene.held[k].since for k in chosen)
    play = [3 * scene.effect(k)[1] + 0.1 * abs(scene.mean[k, 2]) for k in chosen]
    used = []
    for glance in scene.glances:
        effects = np.array([glance.effects.get(scene.held[k].id, np.nan) for k in chosen])
        absent = np.isnan(effects).any() and glance.time < came
        changed = (np.abs(effects - scene.mean[chosen, 2]) > play).any()
        if absent or changed or (scene.time - glance.time) * speed > explainer.table.radius / 4:
            break
        used.append(glance.reading)
    used = used or [scene.glances[0].reading]
    data = Data.together([reading.data for reading in used])
    others = responses(explainer.table, data, np.delete(scene.params, chosen, axis=0))[0]
    return data.less(others), block_diag(*[reading.errors for reading in used])
