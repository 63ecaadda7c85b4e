"""Lifts: which contacts are lifted, which are there again, and what becomes of what is left of them."""

from dataclasses import replace

import numpy as np

from ohmskin.touch.explain import FAINT, Explainer
from ohmskin.touch.revision import NEAR
from ohmskin.touch.scene import STATE, Held, Scene

_LIFTED, _AGAIN = 0.1, 0.2  # shares of its peak below which a contact is lifted, above which it is there again
_SETTLED = 5.0  # settling times after which nothing is left of a lifted contact


def settled(scene: Scene, explainer: Explainer, bar: float, settling: float, elapsed: float) -> Scene:
    """The scene with lifted contacts told from pressing ones; what is left of lifted ones goes over into the drift.

    Args:
        scene: After a frame.
        explainer: What explains data by contacts.
        bar: Standard deviations of its effect above which a lifted contact may be there again.
        settling: Time over which what is left of a lifted contact becomes drift (s).
        elapsed: Since the frame before (s).
    """
    scene = _without_double(scene, explainer)
    held, mean, drift, next_id = [], scene.mean.copy(), scene.drift, scene.next_id
    share = 1 - np.exp(-elapsed / settling)
    for k, one in enumerate(scene.held):
        effect, std = scene.effect(k)
        if not one.lifted:
            one = replace(one, peak=max(one.peak, effect))
            if _faint(effect, std, one):
                one = replace(one, lifted=max(elapsed, 1e-9))
                mean[k, 4:] = 0.0
        elif effect > max(_AGAIN * one.peak, bar * std):
            one = Held(next_id, effect, scene.time)
            next_id += 1
        else:
            one = replace(one, lifted=one.lifted + elapsed)
            if effect > FAINT * std:
                response = explainer.table(mean[k, None, :2], np.sqrt(mean[k, 3])).values[0]
                drift = drift + share * mean[k, 2] * response
                mean[k, 2] *= 1 - share
        held.append(one)
    scene = replace(scene, held=tuple(held), mean=mean, drift=drift, next_id=next_id)
    return scene.without([k for k, one in enumerate(held) if one.lifted > _SETTLED * settling])


def _faint(effect: float, std: float, held: Held) -> bool:
    """Whether so small an effect, known as well as that (m2), is no press any more."""
    return effect < max(_LIFTED * held.peak, FAINT * std)


def _without_double(scene: Scene, explainer: Explainer) -> Scene:
    """The scene without a faint contact beside another one, which takes over its effect: two were seen where one is."""
    if len(scene.held) < 2:
        return scene
    apart = np.linalg.norm(scene.mean[:, None, :2] - scene.mean[:, :2], axis=2)
    for k, one in enumerate(scene.held):
        beside = [j for j in scene.pressing if j != k]
        near = beside and apart[k, beside].min() < NEAR * explainer.table.radius
        if near and (one.lifted or _faint(*scene.effect(k), one)):
            held = list(scene.held)
            if not one.lifted:
                heir = min(beside, key=lambda j: float(apart[k, j]))
                held[heir] = replace(held[heir], id=min(one.id, held[heir].id))
            return _known_gone(replace(scene, held=tuple(held)), explainer, k)
    return scene


def _known_gone(scene: Scene, explainer: Explainer, k: int) -> Scene:
    """The scene without a contact, now that its effect is known to be zero: what that says of the others is made use of."""
    at = STATE * k + 2
    gain = scene.covariance[:, at] / scene.covariance[at, at]
    mean = explainer.within(scene.mean - (gain * scene.mean[k, 2]).reshape(scene.mean.shape))
    covariance = scene.covariance - np.outer(gain, scene.covariance[at])
    return replace(scene, mean=mean, covariance=covariance).without([k])
