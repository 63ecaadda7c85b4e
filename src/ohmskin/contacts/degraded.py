"""Electrodes whose contacts have degraded since calibration: what they do to the sheet looks like touches.

A screw that comes loose is a resistance more in series with its electrode, which every fit allows for. But it also
shunts the sheet less than before, and the current enters elsewhere under it: as if at the electrode the sheet conducted
less, and that a little to one side. No touch of a contact layer does that: it lets the sheet conduct more.
"""

from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.contacts.discs import Both
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.information import Information
from ohmskin.contacts.misfit import QuadraticMisfit
from ohmskin.contacts.solution import Solution
from ohmskin.scan.pairs import in_series

_SURE = 5.0  # standard deviations by which the contact impedance must have risen, beside the error of the contacts
_MAYBE = 3.0  # standard deviations by which the sheet may seem to conduct more there
DOUBTED = 1.0  # s for which contacts are doubted once one has degraded
_MOST = 3  # electrodes at once
_LARGER = 10.0  # times the usual change of a contact impedance that a degraded contact may have


@dataclass(frozen=True, eq=False)
class Degradation:
    """What electrodes whose contacts have degraded change of the two-terminal resistances.

    Args:
        electrodes: Those electrodes.
        directions: (n_pairs, k) what they may change (ohm).
        change: (n_pairs,) what they have changed (ohm).
        errors: (n_pairs, k) what that may be off by, each for one standard deviation (ohm).
    """

    electrodes: tuple[int, ...]
    directions: Floats
    change: Floats
    errors: Floats

    def removed_from(self, data: Information) -> Information:
        """What is measured, less it, and with nothing taken to be known of how large it is."""
        return data.minus(self.change).excluding(self.directions)


@dataclass(frozen=True, eq=False)
class Explained:
    """Data explained by contacts, and electrodes whose contacts have degraded.

    Args:
        solution: The contacts.
        data: What is measured, beside all that those electrodes do.
        degradation: What these do; None: there are none.
        doubtful: Whether contacts may be what such an electrode does, although that does not explain the data better.
    """

    solution: Solution
    data: Information
    degradation: Degradation | None = None
    doubtful: bool = False


def with_degraded(fitter: ContactFitter, data: Both, found: Solution, sure: Floats) -> Explained:
    """The contacts, fewer of them if electrodes whose contacts have degraded explain the rest better, and all as well
    as is usual: swapped wires look like such electrodes, too, and more so than like contacts.

    Args:
        fitter: What fits contacts to data.
        data: What is measured, and the same with the model's error as noise.
        found: The contacts that explain it.
        sure: (n, 4) contacts that are known to be there.
    """
    if len(sure) >= len(found.params):
        return Explained(found, data[0])
    best, beside, degraded, changes = found, data, list[int](), dict[int, Floats]()
    left, doubtful = _left(fitter, data[0], sure), False
    limit = sure_rise(fitter, data[0], found.caused)
    surely = rises_beside(fitter, data[0], found.params) > limit
    while len(best.params) > len(sure) and len(degraded) < _MOST:
        higher = {*np.flatnonzero(surely & (fitter.errors.rises(left) > limit)).tolist()} - {*degraded}
        changes |= {number: changes_at(fitter, number) for number in higher if number not in changes}
        gains = {number: _gain(left.misfit, changes[number]) for number in higher}
        if max(gains.values(), default=0.0) < fitter.bar**2:
            break
        doubtful = True
        degraded.append(max(gains, key=lambda number: gains[number]))
        left = left.marginalised_flat(changes[degraded[-1]])
        beside = beside[0].excluding(changes[degraded[-1]]), beside[1].excluding(changes[degraded[-1]])
        other = fitter.fit_information(*beside)
        best = other if len(sure) <= len(other.params) < len(best.params) else best
    if fitter.price(best, 2 * len(degraded)) >= fitter.price(found, 0) or fitter.poor(beside[0], best.cost):
        return Explained(found, data[0], doubtful=doubtful)
    together = np.hstack([changes[number] for number in degraded])
    likeliest, covariance = _likeliest(_left(fitter, data[0], best.params).misfit, together)
    errors = together @ np.linalg.cholesky(covariance)
    return Explained(best, beside[0], Degradation(tuple(degraded), together, together @ likeliest, errors))


def rises_beside(fitter: ContactFitter, data: Information, contacts: Floats) -> Floats:
    """By how many standard deviations (n_elec,) each contact impedance has risen, beside contacts (n, 4)."""
    return fitter.errors.rises(_left(fitter, data, contacts))


def sure_rise(fitter: ContactFitter, data: Information, caused: Floats) -> float:
    """From how many standard deviations on an impedance has surely risen beside contacts that cause so much (n_pairs,),
    ohm, and whose model errs."""
    return _SURE + fitter.model_error * data.norm(caused)


def strong(fitter: ContactFitter, contacts: Floats) -> Bools:
    """Whether contacts (n, 4) do more than an electrode does whose contact has degraded (n,)."""
    return np.asarray(np.abs(contacts[:, 2]) > np.pi * fitter.squares[0])


def _left(fitter: ContactFitter, data: Information, contacts: Floats) -> Information:
    """What is left beside a common change and contacts (n, 4), whatever they are exactly."""
    left = data.marginalised_common()
    if not len(contacts):
        return left
    caused, slopes = fitter.responses(contacts)
    return left.minus(caused).marginalised_flat(slopes)


def changes_at(fitter: ContactFitter, number: int) -> Floats:
    """What a degraded contact of an electrode may change (n_pairs, 4), for one standard deviation (ohm): a resistance
    in series, conductance there, and that moved to a place on the sheet beside it, along x and y."""
    table, radius, usual = fitter.table, float(np.sqrt(fitter.squares[0])), fitter.errors.contacts
    assert usual is not None
    at = table.electrodes[number]

    def moved(*step: float) -> Floats:
        ends = fitter.onto(at + np.outer([1.0, -1.0], step))
        away = np.linalg.norm(table.offsets(ends, np.stack([at, at])), axis=1)
        return np.asarray(ends[away.argmax()])

    there, *beside = np.pi * radius**2 * table([at, moved(radius, 0.0), moved(0.0, radius)], radius).values
    series = _LARGER * np.abs(usual[:, number]).max() * in_series([number], table.pairs)[:, 0]
    return np.column_stack([series, there, *(one - there for one in beside)])


def _gain(left: QuadraticMisfit, changes: Floats) -> float:
    """What a degraded contact explains more of what is `left`; 0 where its `changes` (n_pairs, 4) are no such ones."""
    likeliest, covariance = _likeliest(left, changes)
    possible = likeliest[1] < _MAYBE * np.sqrt(covariance[1, 1])
    return float(likeliest @ (changes.T @ left.vector[:-1])) if possible else 0.0


def _likeliest(left: QuadraticMisfit, changes: Floats) -> tuple[Floats, Floats]:
    """How much (k,) of `changes` (n_pairs, k) explains what is `left` best, and its covariance (k, k)."""
    covariance = np.asarray(np.linalg.inv(left.normal_products(changes.T)[:, :-1] @ changes + np.eye(changes.shape[1])))
    return covariance @ (changes.T @ left.vector[:-1]), covariance
