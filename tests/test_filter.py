"""Contacts from data, and followed over time: against dense algebra, finite differences, and worlds with another
mesh."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.stats import norm

from ohmskin.arrays import Floats
from ohmskin.contacts import ContactFitter
from ohmskin.contacts.information import Errors, Information, QuadraticMisfit
from ohmskin.contacts.misfit import pair_products
from ohmskin.drive import Candidates, TrackingDrive, base_pattern, complete_pattern
from ohmskin.errors import DataError, ModelError, PatternError
from ohmskin.evaluate import worlds
from ohmskin.evaluate.shapes import Shape
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.scan import Difference, DrivePattern, adjacent
from ohmskin.scan.pairs import in_series
from ohmskin.sensing.locator import targets_of
from ohmskin.skin import Skin
from ohmskin.tracking import ContactFilter, Motion, TrackState
from ohmskin.tracking.birth import birth_threshold
from ohmskin.tracking.lift import with_lifts
from ohmskin.tracking.revision import with_revision

SKIN = Skin.load("paper")
COMPLETE = complete_pattern(SKIN.electrodes)
STEP = 0.01  # seconds between frames
ERROR = {"discs": 0.01, "pressed": 0.05}  # of the disc model in each world; discs are what it is made for
PLACES = [
    (0.05, 0.12),
    (0.1, 0.1),
    (0.03, 0.03),
    (0.17, 0.05),
    (0.08, 0.17),
    (0.062, 0.068),
    (0.16, 0.16),
    (0.011, 0.158),
]


@cache
def model(world: str) -> TransferModel:
    """The estimator's model, scaled to the world's untouched sheet."""
    plain = SKIN.transfer_model()
    measured = worlds.voltages(worlds.sheet(world, "grid").untouched, COMPLETE)
    modelled = plain.voltages(COMPLETE, worlds.CURRENT)
    return plain.scaled(float(modelled @ modelled / (modelled @ measured)))


@cache
def table(world: str) -> ContactTable:
    return ContactTable(model(world))


@cache
def policy(world: str, decibels: float, injections: int = 4) -> TrackingDrive:
    candidates = Candidates.at_currents(COMPLETE, 16, worlds.noise_volts(world, decibels), worlds.CURRENT)
    return TrackingDrive(SKIN.electrodes, lambda: (table(world), candidates), injections, explore=1)


def fitter(world: str, decibels: float, **settings: float) -> ContactFitter:
    return ContactFitter(table(world), worlds.noise_volts(world, decibels), **{"model_error": ERROR[world], **settings})


class Rig:
    """A skin that is touched, under noise, measured frame by frame as the policy asks."""

    def __init__(self, world: str, decibels: float, seed: int, filter_: ContactFilter | None = None) -> None:
        self.world, self.noise = world, worlds.noise_volts(world, decibels)
        self.filter = filter_ or ContactFilter(fitter(world, decibels))
        self.policy, self.rng = policy(world, decibels), np.random.default_rng(seed)
        self.state = self.filter.start()

    def measure(
        self, pattern: DrivePattern, *contacts: Shape, common_drift: float = 0.0, share: float = 1.0
    ) -> Difference:
        """Voltages under `share` of what contacts do, all resistances multiplied by 1 + `common_drift`."""
        rest = worlds.sheet(self.world, "grid").untouched
        change = share * (worlds.touched(self.world, "grid", contacts) - rest) if contacts else 0.0 * rest
        volts = worlds.voltages((1 + common_drift) * (rest + change) - rest, pattern)
        noise = self.noise * self.rng.standard_normal(pattern.n_meas)
        return Difference(pattern, np.full(pattern.n_meas, worlds.CURRENT), volts + noise)

    def frame(
        self, *contacts: Shape, elapsed: float = STEP, common_drift: float = 0.0, share: float = 1.0
    ) -> TrackState:
        pattern = self.policy.next(targets_of(self.state.contacts), self.state.turn)
        difference = self.measure(pattern, *contacts, common_drift=common_drift, share=share)
        reference = worlds.voltages(worlds.sheet(self.world, "grid").untouched, pattern)
        self.state = self.filter.update(self.state, replace(difference, reference=reference), elapsed)
        return self.state

    def run(self, frames: int, *contacts: Shape) -> TrackState:
        for _ in range(frames):
            self.frame(*contacts)
        return self.state


def miss(state: TrackState, at: tuple[float, float]) -> float:
    return min((float(np.hypot(*np.subtract(c.position, at))) for c in state.contacts), default=np.inf)


def press(world: str, at: tuple[float, float], **settings: float) -> Shape:
    return worlds.contact(world, *at, **settings)


def random_difference(pattern: DrivePattern, seed: int, source_loading: bool = False) -> Difference:
    rng = np.random.default_rng(seed)
    currents = rng.uniform(0.5e-3, 2e-3, pattern.n_meas)
    sagging = rng.uniform(-0.2, 0.2, pattern.n_meas) if source_loading else None
    return Difference(pattern, currents, rng.normal(size=pattern.n_meas), sagging)


def products(misfit: QuadraticMisfit) -> Floats:
    """Of the columns of data, themselves last."""
    whole = np.empty((len(misfit.vector) + 1,) * 2)
    whole[:-1, :-1], whole[-1, -1] = misfit.matrix, misfit.constant
    whole[-1, :-1] = whole[:-1, -1] = misfit.vector
    return whole


# --- likelihood -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source_loading", [False, True])
def test_known_drift_is_taken_off_scans_in_the_compiled_pass(source_loading: bool) -> None:
    scans = [random_difference(base_pattern(SKIN.electrodes).with_driven, seed, source_loading) for seed in (1, 2)]
    errors = Errors(0.3, gain=0.2, contacts=np.random.default_rng(5).normal(0, 100.0, (120, 16)), model=0.05)
    drift = np.random.default_rng(6).normal(size=120)
    steady = Information.of(16, errors, [scan.minus(drift) for scan in scans])
    for one, other in zip(Information.of(16, errors, scans, drift), steady, strict=True):
        assert np.array_equal(one.misfit.vector, other.misfit.vector)
        assert np.array_equal(one.misfit.downdates, other.misfit.downdates)
        assert one.misfit.constant == other.misfit.constant


@pytest.mark.parametrize("source_loading", [False, True])
def test_what_scans_say_is_what_dense_algebra_says(source_loading: bool) -> None:
    """With gaps, driven electrodes, errors of currents and contacts, and a common change of all resistances."""
    scans = [
        random_difference(adjacent([range(12)]), 1, source_loading),
        random_difference(base_pattern(SKIN.electrodes).with_driven, 2),
    ]
    scans[0].volts[3], scans[1].currents[5] = np.nan, np.inf
    references = [np.random.default_rng(k).normal(size=scan.pattern.n_meas) for k, scan in enumerate(scans)]
    scans = [replace(scan, reference=known) for scan, known in zip(scans, references, strict=True)]
    errors = Errors(0.3, gain=0.2, contacts=np.random.default_rng(5).normal(0, 100.0, (120, 16)))
    found, _ = Information.of(16, errors, scans)
    known = np.ones(sum(scan.pattern.n_meas for scan in scans), bool)
    known[[3, scans[0].pattern.n_meas + 5]] = False
    currents = np.where(known, np.concatenate([scan.currents for scan in scans]), 0.0)
    rows = np.vstack([scan.combination(16).toarray() for scan in scans]) * currents[:, None]
    reference = np.concatenate(references)
    injection = np.concatenate([scans[0].pattern.measurements[:, 0], 100 + scans[1].pattern.measurements[:, 0]])
    directions = [errors.gain * reference * (injection == number) for number in np.unique(injection)]
    directions += list((rows @ errors.contacts).T)
    wrong = np.column_stack(directions)[known]
    whole = np.column_stack([rows, reference, np.concatenate([scan.volts for scan in scans])])[known]
    covariance = 0.3**2 * np.eye(known.sum()) + wrong @ wrong.T
    np.testing.assert_allclose(
        products(found.misfit), whole.T @ np.linalg.solve(covariance, whole), rtol=1e-8, atol=1e-8
    )
    np.testing.assert_allclose(products(found.white), whole.T @ whole / 0.3**2, rtol=1e-9, atol=1e-9)
    change, beside = np.random.default_rng(3).normal(size=(2, 120, 3))
    columns = np.vstack([change, np.zeros(3)]).astype(np.float32)  # as powers are worked out
    left = whole - np.column_stack([np.zeros((known.sum(), 121)), rows[known] @ change[:, 0]])
    less = found.minus(change[:, 0])
    np.testing.assert_allclose(products(less.misfit), left.T @ np.linalg.solve(covariance, left), rtol=1e-8, atol=1e-7)
    assert less.signal == pytest.approx(np.sqrt(np.mean(left[:, -1] ** 2)) / 0.3)
    covariance += (rows[known] @ beside) @ (rows[known] @ beside).T
    marginal = products(less.marginalised(beside).misfit)
    np.testing.assert_allclose(marginal, left.T @ np.linalg.solve(covariance, left), rtol=1e-7, atol=1e-7)
    for one in (found, less, less.marginalised(beside)):  # of the same places, whatever has been taken off since
        expected = np.einsum("pn,nm,pm->p", change.T, one.misfit.matrix[:-1, :-1], change.T)
        np.testing.assert_allclose(one.misfit.scores(columns)[1], expected, rtol=1e-5)
        np.testing.assert_allclose(one.misfit.norms(change), np.sqrt(expected), rtol=1e-8)
    for one in (
        found.misfit,
        found.white,
        less.marginalised(beside).misfit,
    ):  # as matrix and as products
        np.testing.assert_allclose(
            one.normal_products(np.eye(121)), one.matrix, rtol=1e-8, atol=1e-9 * np.abs(one.matrix).max()
        )
        ones, others = (np.ascontiguousarray(each.T) for each in (change, beside))
        both = np.stack([np.sum(a * (b @ one.matrix[:-1, :-1]), axis=1) for a, b in
                         ((ones, ones), (others, others), (ones, others))], axis=1)  # fmt: skip
        np.testing.assert_allclose(
            pair_products(one.rows, one.downdates, ones, others), both, rtol=1e-7, atol=1e-7 * np.abs(both).max()
        )
    assert found.white.trace == pytest.approx(np.trace(found.white.matrix[:-1, :-1]))
    blind, seeing = (
        np.abs(one.misfit.matrix[:-1, :-1] @ beside).max() for one in (less.marginalised_flat(beside), less)
    )
    assert blind < 1e-5 * seeing
    assert found.norm(change[:, 0]) == pytest.approx(np.linalg.norm(rows[known] @ change[:, 0]) / 0.3)
    for scan in scans:
        expected = scan.currents * (scan.combination(16) @ change[:, 0])
        np.testing.assert_allclose(scan.caused_by(change[:, 0]), expected, rtol=1e-9)


def test_directions_that_depend_on_each_other_are_taken_off_once() -> None:
    """Forty of which six differ, as of contacts at one place: what rounding leaves must not grow."""
    random = np.random.default_rng(0)
    few = 1e6 * random.standard_normal((120, 6))
    many = few @ random.standard_normal((6, 40))
    told, _ = Information.of(16, Errors(0.1), [random_difference(COMPLETE, 1)])
    misfit = replace(told.misfit, vector=random.standard_normal(121), constant=1e3)
    once, often = misfit.marginalised(few), misfit.marginalised(many)
    np.testing.assert_allclose(often.matrix, once.matrix, atol=1e-6 * np.abs(misfit.matrix).max())
    assert often.constant == pytest.approx(once.constant, rel=1e-6)


def test_data_of_driven_electrodes_count_as_much_less_as_their_larger_changes_err_more() -> None:
    scan = random_difference(base_pattern(SKIN.electrodes).with_driven, 2)
    driven = scan.pattern.driven
    scan.volts[driven] *= 100
    (plain, _), (told, wary) = (Information.of(16, Errors(0.1, model=model), [scan]) for model in (0.0, 0.05))
    usual, theirs = (np.hypot(0.1, 0.05 * np.sqrt(np.mean(scan.volts[kind] ** 2))) for kind in (~driven, driven))
    expected = np.sum(scan.volts[~driven] ** 2) + np.sum((usual / theirs * scan.volts[driven]) ** 2)
    assert plain.misfit.constant == pytest.approx(np.sum(scan.volts**2) / 0.1**2)
    assert told.misfit.constant == pytest.approx(expected / 0.1**2)
    assert wary.misfit.constant == pytest.approx(told.misfit.constant / (1 + (0.05 * told.signal) ** 2))


def test_what_a_pattern_cannot_see_takes_nothing_from_what_it_says() -> None:
    scan = random_difference(base_pattern(SKIN.electrodes), 2)  # of electrodes that carry no current
    found, _ = Information.of(16, Errors(1e-6, contacts=in_series(range(16), 16)), [scan])
    beside = found.marginalised_flat(in_series(range(16), 16))
    np.testing.assert_allclose(beside.misfit.matrix, found.misfit.matrix, rtol=0, atol=1e-6 * found.misfit.matrix.max())


@pytest.mark.parametrize("place", PLACES[:5])
@pytest.mark.parametrize("sizes", [(24e-3, 9e-4, 10e-3, -2e-4), (3e-3, 3e-4, 10e-3, -1e-4)])
def test_a_fit_whose_radius_is_at_its_bound_ends_as_soon_as_any(
    place: tuple[float, float], sizes: tuple[float, float, float, float]
) -> None:
    """Of what is stronger at its middle, or at its rim, than any disc: within 0.02 of the best after eight steps."""
    judge, quiet = (
        fitter("discs", 60),
        Difference(COMPLETE, np.full(COMPLETE.n_meas, worlds.CURRENT), np.zeros(COMPLETE.n_meas)),
    )
    discs = np.array([[*place, effect, radius**2] for radius, effect in np.reshape(sizes, (2, 2))])
    told, _ = judge.information(replace(quiet, volts=quiet.caused_by(sum(judge.responses(d[None])[0] for d in discs))))
    start = np.array([[place[0] + 4e-3, place[1] - 3e-3, 3e-4, judge.table.radius**2]])
    few, many = (judge.refine(told, start, rounds=rounds) for rounds in (8, 400))
    assert many.params[0, 3] in judge.squares
    assert few.cost - many.cost < 0.02


def test_a_fit_to_nothing_or_from_no_number_ends() -> None:
    """Its place would be no number, either, which reads outside the table of responses."""
    judge, scan = fitter("discs", 50), random_difference(base_pattern(SKIN.electrodes), 2)
    told, _ = judge.information(scan)
    nothing_left = told.marginalised_flat(np.eye(120))
    assert np.isfinite(judge.heights(*judge.scores(nothing_left))).all()
    judge.refine(nothing_left, judge.added(nothing_left, *judge.scores(nothing_left)).params)
    for effect in (np.nan, np.inf):
        found = judge.refine(told, np.array([[0.1, 0.1, effect, judge.table.radius**2]]))
        assert found.params[0, :2].tolist() == [0.1, 0.1]


def test_a_pattern_of_more_electrodes_than_the_table_has_is_refused() -> None:
    with pytest.raises(PatternError, match=r"electrode 19; there are 16 \(0\.\.15\)"):
        fitter("discs", 50).fit(random_difference(adjacent([range(20)]), 1))


def test_slopes_of_contacts_are_those_of_finite_differences() -> None:
    judge = fitter("discs", 50)
    params = np.array([[0.052, 0.121, 1.2e-4, 7e-5], [0.14, 0.04, 2e-4, 5e-5]])
    caused, slopes = judge.responses(params)
    for k, step in enumerate(np.tile([1e-6, 1e-6, 1e-8, 1e-9], 2)):
        moved = params.copy()
        moved.ravel()[k] += step
        numeric = (judge.responses(moved)[0] - caused) / step
        np.testing.assert_allclose(slopes[:, k], numeric, rtol=1e-3, atol=2e-3 * np.abs(slopes[:, k]).max())


# --- one frame --------------------------------------------------------------------------------------------------------


def test_scores_of_quiet_data_are_standard_normal_and_alarms_no_more_frequent_than_stated() -> None:
    """The bar sums the rate over all places, of which neighbours are alike: the true rate is below the stated one, not
    far."""
    rig, rate = Rig("discs", 50, 1), 0.05
    judge = fitter("discs", 50, false_alarms=rate)
    heights, alarms, frames = [], 0, 800
    for _ in range(frames):
        height = judge.heights(*judge.scores(judge.information(rig.measure(base_pattern(SKIN.electrodes)))[0]))
        heights.append(height)
        alarms += bool(height.max() > judge.bar)
    assert np.std(heights) == pytest.approx(1.0, abs=0.03)
    assert rate / 8 < alarms / frames < rate


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_a_fit_is_accurate(world: str) -> None:
    rig, quick = Rig(world, 50, 2), fitter(world, 50)
    pattern = adjacent(SKIN.electrodes.rings)
    errors = []
    for at in PLACES:
        data = [rig.measure(each, press(world, at)) for each in (base_pattern(SKIN.electrodes), pattern)]
        found = quick.contacts(quick.fit(*data))
        assert len(found) == 1, f"{at}: {found}"
        errors.append(np.linalg.norm(np.subtract(found[0].position, at)))
    assert np.mean(errors) < 2e-3


@pytest.mark.parametrize(("decibels", "apart", "least"), [(50, 0.020, 11), (60, 0.012, 10)])
def test_two_contacts_are_told_apart_and_one_is_not_taken_for_two(decibels: float, apart: float, least: int) -> None:
    """16 pairs of 6 mm discs, 20 mm apart at 50 dB and 12 mm at 60 dB; 24 single ones. 28 injections.

    The fit is told that discs are right to 1 %; with the 5 % that skins get it tells far fewer apart, and only how many
    there are is judged (docs/policies.md has the product's own rates). This holds the code, not the goal. Beside
    shapes, which these discs do not have, one pair less is two.
    """
    places = np.random.default_rng(30)  # the same at both noise levels
    rig, judge = Rig("discs", decibels, 3), fitter("discs", decibels)
    drive = policy("discs", decibels, 22)
    twos = [0, 0]
    for trial in range(40):
        middle, angle = places.uniform(0.03, 0.17, 2), places.uniform(0, np.pi)
        half = 0.5 * apart * np.array([np.cos(angle), np.sin(angle)]) if trial < 16 else np.zeros(2)
        shapes = [press("discs", tuple(middle + half), radius=6e-3)]
        if trial < 16:
            shapes.append(press("discs", tuple(middle - half), radius=6e-3))
        first = rig.measure(base_pattern(SKIN.electrodes), *shapes)
        seen = judge.fit(first)
        targets = targets_of(judge.contacts(seen))
        found = judge.fit(first, rig.measure(drive.next(targets, 0), *shapes))
        twos[trial >= 16] += len(found.params) == 2
    assert twos[0] >= least
    assert twos[1] <= 1


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_contacts_that_were_there_before_are_told_as_if_looked_for_afresh(world: str) -> None:
    """Also when one has moved, gone, or another has come.

    Found at 40 dB (discs) and 50 dB (both): 8, 4 and 0 of 80 counts wrong if afresh, 8, 3 and 0 from before, one of
    which is another; nineteen of twenty places move by a tenth of their standard deviation or less.
    """
    rig, judge = Rig(world, 50, 8), fitter(world, 50)
    patterns, third = (base_pattern(SKIN.electrodes), adjacent(SKIN.electrodes.rings)), press(world, (0.1, 0.03))
    wrong, other, moves = np.zeros(2, int), 0, []
    for at, elsewhere in zip(PLACES * 2, PLACES[1:] + PLACES[:1] + PLACES[3:] + PLACES[:3], strict=True):
        first, second = press(world, at), press(world, elsewhere)
        moved = press(world, (at[0] + 3e-3 * (1 if at[0] < 0.1 else -1), at[1]))
        before = judge.fit(*(rig.measure(each, first, second) for each in patterns))
        for now in ([moved, second], [moved], [moved, third], [], [moved, second, third]):
            told, wary = judge.information(*(rig.measure(each, *now) for each in patterns))
            found = judge.fit_information(told, wary), judge.fit_information(told, wary, before=before)
            wrong += [len(one.params) != len(now) for one in found]
            other += len(found[0].params) != len(found[1].params)
            for params, covariance in zip(found[0].params, found[0].covariances, strict=True):
                away = np.linalg.norm(found[1].params[:, :2] - params[:2], axis=1).min(initial=np.inf)
                moves.append(away / np.sqrt(covariance[0, 0] + covariance[1, 1]))
    assert other <= 2
    assert wrong[1] <= wrong[0] + 1
    assert np.percentile(moves, 90) < 0.1


def test_a_contact_that_conducts_worse_is_found_where_that_is_allowed() -> None:
    rig = Rig("discs", 50, 4)
    data = rig.measure(base_pattern(SKIN.electrodes), press("discs", (0.08, 0.11)), share=-1.0)
    judge = fitter("discs", 50, bipolar=True)
    (found,) = judge.contacts(judge.fit(data))
    assert found.strength < -0.5e-4
    assert np.hypot(found.position[0] - 0.08, found.position[1] - 0.11) < 5e-3
    assert not fitter("discs", 50).fit(data).params[:, 2].max(initial=0.0) > 0.5e-4


def test_what_the_model_errs_of_a_strong_contact_is_no_second_one() -> None:
    """Contacts pressed through foam, which are no discs, at 75 dB: what is left of them stands far above the noise."""
    rig, judge = Rig("pressed", 75, 14), fitter("pressed", 75)
    for at in PLACES:
        data = [rig.measure(each, press("pressed", at)) for each in (base_pattern(SKIN.electrodes), COMPLETE)]
        found = judge.fit(*data)
        assert len(found.params) == 1, at
        assert np.hypot(*(found.params[0, :2] - at)) < 3e-3


def test_a_place_is_known_no_better_than_the_model_allows() -> None:
    params, sure = np.array([0.1, 0.1, 1e-4, 6e-5]), np.diag([1e-12, 1e-12, 1e-14, 1e-16])
    for error in (0.02, 0.05):
        judge = fitter("discs", 50, model_error=error)
        covariance = np.array(judge.contact(params, sure).covariance)
        share = np.sqrt(np.diag(covariance)) / (error * judge.table.radius)
        assert (share > 1.0).all()
        assert (share < 4.0).all()
        assert covariance[0, 1] == 0.0


# --- many frames ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_contacts_are_found_within_three_frames_and_known_as_well_as_is_said(world: str) -> None:
    """At 40 dB, 4 injections per frame; the squared error over its covariance is 2 on average if that is honest."""
    lags, errors, ratios = [], [], []
    for seed, at in enumerate(PLACES):
        rig, touch = Rig(world, 40, seed), press(world, at)
        assert not rig.run(4 + seed % 3).contacts
        lags.append(next(k for k in range(1, 9) if rig.frame(touch).contacts))
        (one,) = rig.run(12, touch).contacts
        for _ in range(10):
            (contact,) = rig.frame(touch).contacts
            assert contact.id == one.id
            off = np.subtract(contact.position, at)
            errors.append(np.linalg.norm(off))
            ratios.append(off @ np.linalg.solve(contact.covariance, off))
    assert max(lags) <= 3
    assert np.mean(errors) < 3e-3
    assert 0.5 < np.mean(ratios) < 3.5


@pytest.mark.parametrize("decibels", [40, 50])
def test_another_contact_is_found_while_one_is_tracked(decibels: int) -> None:
    """At all places, three seeds; at 40 dB one 27 mm away is found in half of the cases only (guide/tracking.md)."""
    misses = []
    for seed, (number, at) in product(range(3), enumerate(PLACES)):
        rig, first = Rig("discs", decibels, 10 * number + seed), press("discs", (0.125, 0.09))
        (known,) = rig.run(12, first).contacts
        if decibels == 40 and at == (0.1, 0.1):
            continue
        second = press("discs", at)
        lag = next(k for k in range(1, 9) if len(rig.frame(first, second).contacts) == 2)
        assert lag <= 3, at
        after = rig.run(16, first, second)
        assert known.id in {c.id for c in after.contacts}
        misses.append(miss(after, at))
    assert np.mean(misses) < (4e-3 if decibels == 40 else 2e-3)
    assert np.max(misses) < (15e-3 if decibels == 40 else 8e-3)


def test_a_tracked_contact_does_not_grow_to_explain_a_new_one_beside_it() -> None:
    """On the layer of patches at 40 dB, 25 to 32 mm apart, at 24 places: most are found within three frames."""
    random, found, grown = np.random.default_rng(21), [], []
    for number in range(24):
        middle, angle = random.uniform(0.04, 0.16, 2), random.uniform(0, np.pi)
        half = random.uniform(12.5e-3, 16e-3) * np.array([np.cos(angle), np.sin(angle)])
        one, other = (press("pressed", tuple(middle + side * half)) for side in (1, -1))
        rig = Rig("pressed", 40, 100 + number, ContactFilter(fitter("pressed", 40, model_error=0.07)))
        (known,) = rig.run(12, one).contacts
        states = [rig.frame(one, other) for _ in range(3)]
        found.append(any(len(state.contacts) == 2 for state in states))
        after = next(contact for contact in states[0].contacts if contact.id == known.id)
        grown.append(after.strength / known.strength)
    assert np.mean(found) >= 0.8
    assert np.median(grown) < 1.3


@pytest.mark.parametrize("world", ["discs", "pressed"])
def test_two_that_come_together_are_two_from_the_fifth_frame_on(world: str) -> None:
    """35 mm apart, at ten places; found one after the other, three of four pairs of strong ones had a third beside."""
    random, errors = np.random.default_rng(12), []
    for number in range(10):
        middle, angle = random.uniform(0.035, 0.165, 2), random.uniform(0, np.pi)
        half = 17.5e-3 * np.array([np.cos(angle), np.sin(angle)])
        rig, both = Rig(world, 50, number), [press(world, tuple(middle + side * half)) for side in (1, -1)]
        rig.run(4, *both)
        for _ in range(12):
            state = rig.frame(*both)
            assert len(state.contacts) == 2, middle
        errors += [miss(state, tuple(middle + side * half)) for side in (1, -1)]
    assert np.mean(errors) < 3e-3


def test_nothing_is_felt_on_a_quiet_skin() -> None:
    rig = Rig("discs", 40, 9)
    for _ in range(1500):
        assert not rig.frame().tracks


def test_a_moving_contact_is_followed_with_its_velocity() -> None:
    """1.5 to 3.1 mm a frame along a bent path, at 50 dB; velocities are no further off than the filter says."""
    errors, off, said = [], [], []
    for seed in range(4):
        rig = Rig("discs", 50, seed)
        for k in range(50):
            at = (0.04 + 1.2e-3 * k, 0.05 + 0.9e-3 * k + 2e-5 * k**2)
            state = rig.frame(press("discs", at))
            if k >= 10:
                (contact,) = state.contacts
                assert contact.id == 1
                errors.append(np.hypot(*np.subtract(contact.position, at)))
            if k >= 20:
                assert contact.velocity is not None
                off.append(np.subtract(contact.velocity, [0.12, 0.09 + 4e-3 * k]))
                said.append(np.diag(state.covariance)[4:6])
    assert np.mean(errors) < 2.5e-3
    assert (np.mean(np.square(off), axis=0) < np.mean(said, axis=0)).all()
    assert (np.mean(said, axis=0) < 0.5**2 * Motion().speed ** 2).all()  # and it says more than that fingers move


def test_a_lifted_contact_is_gone_at_once_and_pressed_again_it_is_a_new_one() -> None:
    rig, touch = Rig("pressed", 60, 6), press("pressed", (0.07, 0.13))
    (first,) = rig.run(15, touch).contacts
    assert not rig.run(2).contacts
    assert not any(rig.frame().contacts for _ in range(30))
    assert len(rig.run(2, touch).contacts) == 1
    (second,) = rig.run(10, touch).contacts
    assert second.id == first.id + 1
    assert miss(rig.state, (0.07, 0.13)) < 3e-3


def resting(rig: Rig, effect: float, lifted: float = 0.0) -> TrackState:
    """A contact of name 1 that moves at 0.1 m/s, of this effect, of ten times 1e-5 m2 at its peak."""
    params, square = np.array([0.07, 0.13, 1e-4, rig.filter.fitter.table.radius**2]), 1e-14
    state = rig.filter.start().with_contact(params, np.diag([1e-8, 1e-8, square, 1e-12]), 0.1)
    state.mean[0, 2], state.mean[0, 4:] = effect, (0.08, -0.06)
    return replace(state, tracks=(replace(state.tracks[0], lifted=lifted),), time=3.0)


def test_a_contact_that_is_lifted_stands_still() -> None:
    rig = Rig("discs", 50, 15)
    pressing = with_lifts(resting(rig, 9e-5), rig.filter.fitter, rig.filter.bar, 30.0, STEP)
    assert not pressing.tracks[0].lifted
    assert pressing.mean[0, 4:].tolist() == [0.08, -0.06]
    gone = with_lifts(resting(rig, 0.5e-5), rig.filter.fitter, rig.filter.bar, 30.0, STEP)
    assert gone.tracks[0].lifted
    assert gone.mean[0, 4:].tolist() == [0.0, 0.0]


def test_a_lifted_contact_that_is_there_again_before_it_is_forgotten_is_a_new_one() -> None:
    rig = Rig("discs", 50, 16)
    still = with_lifts(resting(rig, 1e-5, lifted=0.2), rig.filter.fitter, rig.filter.bar, 30.0, STEP)
    assert still.tracks[0].lifted == pytest.approx(0.2 + STEP)
    assert (still.tracks[0].id, still.next_id) == (1, 2)
    again = with_lifts(resting(rig, 8e-5, lifted=0.2), rig.filter.fitter, rig.filter.bar, 30.0, STEP)
    assert not again.tracks[0].lifted
    assert (again.tracks[0].id, again.next_id, again.tracks[0].since) == (2, 3, 3.0)
    assert again.tracks[0].peak == pytest.approx(8e-5)


def test_what_is_left_of_a_lifted_contact_becomes_drift_in_frames_that_are_explained() -> None:
    rig = Rig("discs", 50, 16)
    before = resting(rig, 1e-5, lifted=0.2)
    told, untold = (
        with_lifts(before, rig.filter.fitter, rig.filter.bar, 30.0, STEP, explained) for explained in (True, False)
    )
    assert 0 < told.mean[0, 2] < before.mean[0, 2] == untold.mean[0, 2]
    assert np.abs(told.drift).max() > 0
    assert not untold.drift.any()


def test_of_two_contacts_taken_for_one_the_older_name_stays() -> None:
    rig = Rig("discs", 50, 17)
    state = rig.run(12, press("discs", (0.085, 0.12)))
    params, covariance = state.params[0].copy(), state.covariance_of(0)
    params[2] /= 2
    for names in ((7, 3), (3, 7)):
        doubled = state.without([0])
        for name, side in zip(names, (-1e-3, 1e-3), strict=True):
            doubled = doubled.with_contact(params + np.array([side, 0.0, 0.0, 0.0]), covariance, 0.1, name)
        doubled = replace(doubled, tracks=tuple(replace(track, since=-1.0) for track in doubled.tracks))
        (kept,) = with_revision(doubled, rig.filter.fitter, rig.filter.split_bar, 0.1, 0).tracks
        assert kept.id == 3


def test_two_that_were_fitted_in_vain_are_fitted_again_where_they_promise_more_and_every_fourth_turn() -> None:
    for seed in range(4):
        rig = Rig("discs", 50, seed)
        state = rig.run(8, press("discs", PLACES[seed]))

        def look(refuted: float, turn: int, rig: Rig = rig, state: TrackState = state) -> float:
            """What is refuted after a look; -1 where nothing was fitted."""
            given = replace(state, tracks=(replace(state.tracks[0], refuted=refuted),))
            after = with_revision(given, rig.filter.fitter, rig.filter.split_bar, 0.1, turn)
            return -1.0 if after is given else after.tracks[0].refuted

        promise = look(0.0, 1)
        assert promise > 0
        assert [look(share * promise, 1) for share in (0.49, 0.51, 1.0, 2.0)] == [promise, -1.0, -1.0, -1.0]
        assert [look(promise, turn) for turn in (2, 3, 4, 5)] == [-1.0, -1.0, promise, -1.0]


def test_contacts_that_explain_data_poorly_are_looked_for_afresh_in_the_second_look_while_new_or_at_larger_doubts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Data err a quarter more than the filter is told; there is next to nothing to be found."""
    judge, calls = fitter("discs", 50), list[int]()
    search = judge.fit_information
    monkeypatch.setattr(judge, "fit_information", lambda *given: [calls.append(1), search(*given)][1])
    for seed, place in enumerate(PLACES):
        state = Rig("discs", 48, seed, ContactFilter(judge)).run(30, press("discs", place))
        state, looks = replace(state, history=4 * state.history[:1]), []
        for since, refuted, turn in ((-1, 0, 1), (-1, 0.5, 1), (state.time, 0, 1), (-1, 3, 1), (-1, 3, 4)):
            calls.clear()
            tracks = tuple(replace(track, since=since) for track in state.tracks)
            after = with_revision(replace(state, tracks=tracks, refuted=refuted), judge, np.inf, 0.1, turn)
            looks.append((len(calls), after.refuted))
        assert [count for count, _ in looks] == [0, 1, 1, 0, 1]
        doubt = looks[1][1]
        assert [left for _, left in looks] == [0.5, doubt, doubt, 3, doubt]
        assert doubt == 0.0 or 1 < doubt < 3  # others were found, or not


def test_what_a_search_found_nothing_about_is_searched_again_only_if_there_is_more_of_it() -> None:
    """Data that err a quarter more than the fit is told leave a residual that calls for a search, in vain."""
    judge = fitter("discs", 50)
    for seed, place in enumerate(PLACES):
        told, wary = judge.information(Rig("discs", 48, seed).measure(COMPLETE, press("discs", place)))
        fresh = judge.fit_information(told, wary)
        assert judge.refitted(told, wary, fresh) is None
        searched = judge.fit_information(told, wary, before=fresh)
        assert searched.doubts is not None
        assert searched.doubts.max() > 1
        assert (judge.refitted(told, wary, searched) or (None, False))[1]
        assert judge.refitted(told, wary, replace(searched, doubts=0.8 * searched.doubts)) is None


def test_contacts_that_explain_data_poorly_are_followed_only_while_data_look_the_same() -> None:
    """One contact, which is all that is looked for, where two press.

    Where one of them is lifted, what is left may be as large by chance: it is at one of 16, with each of eight seeds.
    """
    judge, moves, alike = fitter("discs", 50, most=1), [], 0
    for seed, (at, elsewhere) in product(range(4), zip(PLACES, PLACES[1:] + PLACES[:1], strict=True)):
        rig, pressed = Rig("discs", 50, seed), (press("discs", at), press("discs", elsewhere))
        told, wary = judge.information(rig.measure(COMPLETE, *pressed))
        found = judge.fit_information(told, wary)
        assert judge.poor(told.marginalised_common(), found.cost)
        before = replace(found, poor=told.signals(found.caused)[1])
        told, wary = judge.information(rig.measure(COMPLETE, *pressed))
        same = judge.followed(told, wary, before)
        assert same is not None
        moves.append(np.linalg.norm(same.params[0, :2] - found.params[0, :2]))
        assert judge.followed(told, wary, found) is None  # which had not been searched for without success
        none, *one = (judge.information(rig.measure(COMPLETE, *others)) for others in ([], pressed[:1], pressed[1:]))
        assert judge.followed(*none, before) is None
        alike += sum(judge.followed(*each, before) is not None for each in one)
    assert alike <= 4
    assert np.percentile(moves, 90) < 1e-3, sorted(moves)[-8:]


def test_the_rate_of_false_alarms_is_shared_by_the_windows_in_which_contacts_are_looked_for() -> None:
    judge = fitter("discs", 50)
    assert 7 * norm.sf(birth_threshold(judge)) == pytest.approx(norm.sf(judge.bar), rel=1e-9)


def test_noise_of_the_reference_which_all_frames_share_does_not_add_up_to_a_contact() -> None:
    """The same noise in each of twelve frames, at four fifths of the bar: one glimpse, however often it is repeated."""
    rig, pattern = Rig("discs", 50, 18), base_pattern(SKIN.electrodes)
    error = rig.measure(pattern)
    judge = rig.filter.fitter
    height = judge.heights(*judge.scores(judge.information(error)[0])).max()
    error = replace(error, volts=error.volts * 0.8 * rig.filter.bar / height)
    found = []
    for repeats in (1.0, np.inf):
        filter_ = ContactFilter(judge, repeats=repeats)
        state = filter_.start()
        for _ in range(12):
            state = filter_.update(state, error, STEP)
        found.append(len(state.tracks))
    assert found[0] == 0
    assert found[1] > 0  # as if each frame had noise of its own


def test_a_contact_that_parts_becomes_two_and_one_again() -> None:
    rig = Rig("discs", 60, 7)

    def pair(half: float) -> tuple[Shape, Shape]:
        return press("discs", (0.085 - half, 0.12), radius=6e-3), press("discs", (0.085 + half, 0.12), radius=6e-3)

    (one,) = rig.run(20, press("discs", (0.085, 0.12), radius=8e-3)).contacts
    for k in range(1, 11):
        rig.run(3, *pair(1.5e-3 * k))
    apart = rig.run(30, *pair(15e-3))
    assert len(apart.contacts) == 2
    assert one.id in {c.id for c in apart.contacts}
    assert (
        max(miss(apart, (0.07, 0.12)), miss(apart, (0.1, 0.12))) < 7e-3
    )  # three standard deviations between the electrodes
    for k in range(10, 0, -1):
        rig.run(3, *pair(1.5e-3 * k))
    (again,) = rig.run(40, press("discs", (0.085, 0.12), radius=8e-3)).contacts
    assert miss(rig.state, (0.085, 0.12)) < 4e-3
    assert again.id in {c.id for c in apart.contacts}


# --- drift ------------------------------------------------------------------------------------------------------------


def test_a_finger_resting_ten_minutes_while_it_warms_is_neither_swallowed_nor_multiplied() -> None:
    """1 % a minute, at 70 dB: in the end all voltages are off by 300 times the noise."""
    rig, touch, strengths = Rig("pressed", 70, 8), press("pressed", (0.06, 0.13)), []
    pause = 0.5
    for k in range(1200):
        common_drift = 0.01 * k * pause / 60
        state = rig.frame(*((touch,) if k > 10 else ()), elapsed=pause, common_drift=common_drift)
        assert len(state.contacts) == (k > 10), k
        strengths += [c.strength for c in state.contacts]
    grown = np.mean(strengths[-50:]) / np.mean(strengths[50:100])
    assert grown == pytest.approx(1.1, rel=0.05)  # as have all resistances, and what a contact does to them
    assert state.common_drift[0] == pytest.approx(0.1, abs=0.01)
    assert miss(state, (0.06, 0.13)) < 3e-3
    for _ in range(20):
        assert not rig.frame(elapsed=pause, common_drift=0.1).contacts


def test_what_the_foam_keeps_of_a_press_is_no_contact_and_soon_forgotten() -> None:
    """5 % of the signal after the finger has gone, dying away in 30 s."""
    rig, touch = Rig("pressed", 70, 9), press("pressed", (0.12, 0.07))
    rig.run(100, touch)
    for k in range(600):
        state = rig.frame(touch, share=0.05 * np.exp(-k * 0.05 / 30), elapsed=0.05)
        assert not state.contacts or k == 0, (k, state.contacts)
    light = rig.frame(touch, share=0.05 * np.exp(-1) + 0.25, elapsed=0.05)
    light = rig.frame(touch, share=0.05 * np.exp(-1) + 0.25, elapsed=0.05)
    assert len(light.contacts) == 1  # a quarter as hard as before, on the same spot


@pytest.mark.parametrize(("times", "most", "off"), [(1.0, 1, 3e-3), (3.0, 2, 4.5e-3)])
def test_single_pairs_may_drift_by_about_the_noise(times: float, most: int, off: float) -> None:
    """Random changes of two-terminal resistances that grow within two minutes, by the noise, and by three times that.

    Six seeds. Beyond about the noise a touch may show a further contact beside it; ten times is not followed at all.
    Of twelve seeds none shows two contacts after twelve frames where pairs drift by the noise, three where by three
    times that; means of errors are 1.4 and 2.6 mm, the largest 5.5 and 4.8.
    """
    more, missed = 0, []
    for seed in range(6):
        rig = Rig("discs", 50, 10 + seed)
        drift = np.random.default_rng(seed).normal(size=120) * times * rig.noise / worlds.CURRENT

        def frame(k: int, *contacts: Shape, elapsed: float, rig: Rig = rig, drift: np.ndarray = drift) -> TrackState:
            pattern = rig.policy.next(targets_of(rig.state.contacts), rig.state.turn)
            difference = rig.measure(pattern, *contacts)
            shifted = difference.volts + worlds.CURRENT * (pattern.combination(16) @ drift) * min(k / 1200, 1.0)
            rig.state = rig.filter.update(rig.state, replace(difference, volts=shifted), elapsed)
            return rig.state

        assert not any(frame(k, elapsed=0.1).contacts for k in range(1600)), seed
        for k in range(12):
            frame(1600 + k, press("discs", (0.13, 0.14)), elapsed=STEP)
        assert 1 <= len(rig.state.contacts) <= 2, seed
        more += len(rig.state.contacts) > most
        missed.append(miss(rig.state, (0.13, 0.14)))
    assert more <= 1
    assert np.mean(missed) < off
    assert max(missed) < 2 * off


# --- state and errors -------------------------------------------------------------------------------------------------


def test_the_same_frames_give_the_same_to_the_last_bit_and_the_old_scene_is_left_alone() -> None:
    rig, touch = Rig("discs", 50, 11), press("discs", (0.05, 0.07))
    before = rig.run(6, touch)
    kept = before.mean.copy(), before.covariance.copy(), before.drift.copy()
    difference = rig.measure(rig.policy.next(targets_of(before.contacts), before.turn), touch)
    a, b = (rig.filter.update(before, difference, STEP) for _ in range(2))
    np.testing.assert_array_equal(a.mean, b.mean)
    assert a.contacts == b.contacts
    for old, now in zip(kept, (before.mean, before.covariance, before.drift), strict=True):
        np.testing.assert_array_equal(old, now)


def test_recent_frames_make_up_a_scan() -> None:
    rig = Rig("discs", 50, 12)
    state = rig.run(9)
    assert [d.pattern.n_inj for d in state.recent(16)] == [4, 4, 4, 4]
    assert len(state.recent(1)) == 1
    assert sum(d.pattern.n_inj for d in state.recent(1000)) == 36


def test_what_the_skin_keeps_of_a_press_grows_while_it_lasts_and_fades_after_it() -> None:
    motion = Motion(drift_time=5.0, creep_time=30.0)
    short, long = motion.kept(0.0, 100.0, 0.05), motion.kept(0.0, 100.0, 30.0)
    assert short == pytest.approx(1.0, rel=0.01)
    assert 99 < long < 100
    kept = 0.0
    for _ in range(100):
        kept = motion.kept(kept, 100.0, 0.01)
    assert kept == pytest.approx(motion.kept(0.0, 100.0, 1.0))
    assert motion.kept(long, 0.0, 30.0) == pytest.approx(long / np.e)
    assert motion.kept(long, 20.0, 1e4) == 20.0


def test_a_frame_without_data_and_settings_out_of_range_are_refused() -> None:
    rig = Rig("discs", 50, 13)
    empty = rig.measure(base_pattern(SKIN.electrodes))
    empty.volts[:] = np.nan
    with pytest.raises(DataError, match="no finite measurement"):
        rig.filter.update(rig.state, empty, STEP)
    with pytest.raises(DataError, match="no scan"):
        rig.filter.fitter.fit()
    with pytest.raises(ModelError, match="elapsed is -1"):
        rig.filter.update(rig.state, rig.measure(base_pattern(SKIN.electrodes)), -1)
    with pytest.raises(ModelError, match="false_alarms is 0"):
        fitter("discs", 50, false_alarms=0)
    with pytest.raises(ModelError, match="speed is -0"):
        Motion(speed=-0.1)
