"""Images in classes: none without evidence, both where both are there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ohmskin.contacts import evidence, segments
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.inverse import GaussNewton
from ohmskin.scan import Baseline, Difference, DrivePattern, adjacent
from ohmskin.skin import Skin

NOISE = 2e-6
CONDUCTIVE, RESISTIVE = (0.05, 0.13, 4.0), (0.14, 0.06, 0.2)  # where (m), and conductivity against the sheet's


@cache
def sheet() -> tuple[TransferModel, DrivePattern]:
    skin = Skin.load("paper-rim16")
    skin = replace(skin, imaging=replace(skin.imaging, mesh_size=10e-3))
    return skin.transfer_model(), adjacent(skin.electrodes.rings)


def changed(*targets: tuple[float, float, float], seed: int = 0) -> Difference:
    """The change that round targets of 18 mm make, with noise."""
    model, pattern = sheet()
    factor = np.ones(model.mesh.n_elem)
    for x, y, ratio in targets:
        factor[np.linalg.norm(model.mesh.centroids - (x, y), axis=1) < 18e-3] = ratio
    quiet = model.simulate(pattern, 1e-3, NOISE, count=30, seed=1000)
    touched = model.with_conductivity(model.conductivity * factor).simulate(pattern, 1e-3, NOISE, seed=seed)
    return Baseline.learn(quiet).difference(touched[0])


def found(difference: Difference) -> dict[int, bool]:
    return {sign: one.significant for sign, one in evidence(sheet()[0], NOISE, [difference], freedom=1000).items()}


@pytest.mark.parametrize(
    ("targets", "classes"),
    [
        ((CONDUCTIVE,), {1}),
        ((RESISTIVE,), {-1}),
        ((CONDUCTIVE, RESISTIVE), {1, -1}),
        ((CONDUCTIVE, (0.15, 0.15, 3.0)), {1}),
    ],
)
def test_the_classes_that_are_there_are_found_and_no_other(
    targets: tuple[tuple[float, float, float], ...], classes: set[int]
) -> None:
    model, _ = sheet()
    difference = changed(*targets)
    needed = evidence(model, NOISE, [difference], freedom=1000)
    assert {sign for sign, one in needed.items() if one.significant} == classes
    image = GaussNewton(model, NOISE, "matern", amplitude=0.5, model_error=0.02).reconstruct(difference)
    told = segments(image, model.mesh, needed)
    assert set(np.unique(told.labels)) == {0, *classes}
    areas = told.areas(model.mesh)
    assert {1: areas["conductive"] > 0, -1: areas["resistive"] > 0} == {sign: sign in classes for sign in (1, -1)}
    for x, y, ratio in targets:
        at = int(np.argmin(np.linalg.norm(model.mesh.centroids - (x, y), axis=1)))
        assert told.labels[at] == np.sign(ratio - 1)


def test_noise_makes_a_class_no_more_often_than_stated() -> None:
    """One per cent of homogeneous data at most: of 40, more than two would be a chance of one in a hundred."""
    alarms = [any(found(changed(seed=seed)).values()) for seed in range(40)]
    assert sum(alarms) <= 2


@pytest.mark.parametrize("target", [CONDUCTIVE, RESISTIVE])
def test_where_either_class_alone_explains_the_change_it_is_undecided(target: tuple[float, float, float]) -> None:
    """As without an electrode, in adjacent drive: the image has the sign of least variance, the data have none."""
    model, pattern = sheet()
    lost = (pattern.quadruples == 2).any(axis=1)
    whole, without, nothing = (
        changed(target),
        *(replace(one, volts=np.where(lost, np.nan, one.volts)) for one in (changed(target), changed())),
    )
    for one in evidence(model, NOISE, [without], freedom=1000).values():
        assert one.undecided
        assert not one.significant
    for difference in (whole, nothing):
        assert not any(one.undecided for one in evidence(model, NOISE, [difference], freedom=1000).values())


def test_more_noise_needs_more_evidence_and_bad_settings_are_refused() -> None:
    model, _ = sheet()
    difference = changed((0.05, 0.13, 1.02))
    strict = evidence(model, 50 * NOISE, [difference])
    assert not any(one.significant for one in strict.values())
    assert found(difference)[1]
    for rate, freedom in ((0.0, 60), (1.0, 60), (0.01, 0)):
        with pytest.raises(DataError, match="rate of false alarms"):
            evidence(model, NOISE, [difference], freedom, rate)
