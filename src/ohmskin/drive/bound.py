"""How well contacts can be located at all: the bound of Cramer and Rao, for any drive."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from ohmskin.arrays import Floats, Ints
from ohmskin.cache import cached
from ohmskin.drive.design import CURRENT, Candidates, exchange, whitened
from ohmskin.drive.drive import Drive, Target
from ohmskin.errors import ModelError
from ohmskin.forward import ContactTable
from ohmskin.scan import DrivePattern

PARAMETERS = 4  # of each contact: x and y in metres, effect over the usual one, log radius
Scheme = DrivePattern | Drive | Callable[[Floats], Sequence[DrivePattern]]


@dataclass(frozen=True)
class ContactPrior:
    """Prior of a contact.

    Args:
        effect: Usual relative conductivity change times area (m2).
        radius: Usual radius (m).
        position: Standard deviation of each coordinate (m).
        effect_spread: Standard deviation of the effect over the usual one.
        radius_spread: Standard deviation of the logarithm of the radius.

    Raises:
        ModelError: If one of them is not positive.
    """

    effect: float
    radius: float
    position: float
    effect_spread: float = 1.0
    radius_spread: float = 0.3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise ModelError(f"contact {name} is {value!r}; it must be finite and positive")

    @classmethod
    def usual(cls, radius: float, position: float = 6.0, effect_spread: float = 1.0) -> "ContactPrior":
        """The prior of a usual contact, one that changes conductivity by a half.

        Args:
            radius: Usual radius (m).
            position: Standard deviation of each coordinate, in radii (1).
            effect_spread: Standard deviation of the effect over the usual one (1).
        """
        return cls(0.5 * np.pi * radius**2, radius, position * radius, effect_spread)

    def scaled(self, factor: float) -> "ContactPrior":
        """The same prior with all lengths times `factor` and areas times its square, as on a map."""
        lengths = self.effect * factor**2, self.radius * factor, self.position * factor
        return ContactPrior(*lengths, self.effect_spread, self.radius_spread)

    def covariance(self, targets: Sequence[Target] | None = None) -> Floats:
        """Of one contact (4, 4), or of several (4 n, 4 n) whose positions have the covariances of `targets`."""
        places = [np.eye(2) * self.position**2] if targets is None else [target.covariance for target in targets]
        rest = np.diag([self.effect_spread**2, self.radius_spread**2])
        return np.asarray(block_diag(*(block for place in places for block in (place, rest))))

    def at(self, places: ArrayLike) -> list[Target]:
        """Usual contacts at places (n, 2) in metres."""
        spread = np.eye(2) * self.position**2
        return [Target(place, spread, self.effect, self.radius) for place in np.asarray(places, float).reshape(-1, 2)]


def contact_columns(table: ContactTable, targets: Sequence[Target]) -> Floats:
    """Derivatives (n, n_pairs, 4) of the two-terminal resistances by each contact's parameters (ohms per unit)."""
    effect, radius = (np.array([getattr(target, name) for target in targets])[:, None] for name in ("effect", "radius"))
    response = table(np.array([target.position for target in targets]), radius[:, 0])
    along = (response.slopes[:, 0], response.slopes[:, 1], response.values, 2 * radius**2 * response.widening)
    return np.asarray(np.stack(along, axis=-1) * effect[..., None])


def position_goals(contacts: int) -> Floats:
    """The goals (n, 2, 4 n) of knowing the position of each contact."""
    return np.eye(PARAMETERS * contacts).reshape(contacts, PARAMETERS, -1)[:, :2]


def position_bound(
    table: ContactTable,
    places: ArrayLike,
    scheme: Scheme,
    noise: float,
    currents: ArrayLike = CURRENT,
    prior: ContactPrior | None = None,
    scale: ArrayLike = 1.0,
) -> Floats:
    """Cramer-Rao bound (n,) of the root-mean-square position error of one contact at each place (m).

    Position, effect and radius are unknown up to the prior. Adaptive schemes choose for the true place: their bound
    assumes that the first scan gave it.

    Args:
        table: Responses of contacts.
        places: (n, 2) in metres.
        scheme: A pattern, a drive, or a function that returns the patterns for a contact at a place (2,).
        noise: Standard deviation of a voltage (V).
        currents: One value, or one for each electrode pair (n_pairs,) in amperes.
        prior: Prior of the contact; `ContactPrior.usual` of the table's radius unless given.
        scale: Metres on the skin for one on its map, where the skin is curved: one value, or one for each place. The
            prior and the error are in metres on the skin.

    Raises:
        ModelError: If noise or currents are not positive.
        PatternError: If an electrode is not there.
    """
    prior = prior or ContactPrior.usual(table.radius)
    metres = np.broadcast_to(np.asarray(scale, float), len(np.reshape(places, (-1, 2))))
    priors = [prior.scaled(1 / one) for one in metres.tolist()]
    targets = [own.at(place)[0] for own, place in zip(priors, np.reshape(places, (-1, 2)), strict=True)]
    known: dict[DrivePattern, sp.csr_array] = {}
    errors = np.empty(len(targets))
    for k, column in enumerate(contact_columns(table, targets)):
        information = np.linalg.inv(priors[k].covariance())
        for pattern in _driven(scheme, targets[k]):
            if pattern not in known:
                known[pattern] = whitened(pattern, table.pairs, noise, currents)
            rows = known[pattern] @ column
            information += rows.T @ rows
        errors[k] = metres[k] * np.sqrt(np.trace(np.linalg.inv(information)[:2, :2]))
    return errors


def best_fixed(table: ContactTable, candidates: Candidates, injections: int, places: ArrayLike | None = None) -> Ints:
    """The fixed set of injections (count,) with the least mean squared position bound, by greedy choice and exchanges.

    The prior is `ContactPrior.usual` of the table's radius.

    Args:
        table: Responses of contacts.
        candidates: The injections to choose from, as many as `injections`.
        places: (n, 2) where contacts may be, in metres; all over the sheet unless given.

    Raises:
        PatternError: If there are fewer candidates than that.
    """
    prior = ContactPrior.usual(table.radius)
    places = spread_places(table) if places is None else np.asarray(places, float)

    def make() -> dict[str, Ints]:
        rows = candidates.rows(contact_columns(table, prior.at(places)))
        return {"chosen": exchange(rows, prior.covariance(), injections, position_goals(1))}

    return cached("best-fixed", (*design_inputs(table, candidates), injections, places), make)["chosen"]


def design_inputs(table: ContactTable, candidates: Candidates) -> tuple[NDArray[np.generic] | float | None, ...]:
    """All that a choice of injections depends on, as inputs of `cached`.

    Args:
        table: Responses of contacts.
        candidates: The injections to choose from.
    """
    sharp, contacts = candidates.sharp or (candidates.weights, None)
    matrices = [part for one in (candidates.weights, sharp) for part in (one.data, one.indices, one.indptr)]
    return *table.content, table.electrodes, candidates.pattern.quadruples, *matrices, contacts, candidates.pairs.ends


def spread_places(table: ContactTable, count: int = 150) -> Floats:
    """About `count` places of a table where a contact lies wholly on the sheet, evenly over it (n, 2) in metres."""
    places = table.places[table.whole]
    low, high = places.min(axis=0), places.max(axis=0)
    step = float(np.sqrt(np.prod(high - low) / count))
    axes = [np.linspace(low[k], high[k], max(round((high[k] - low[k]) / step) + 1, 2)) for k in range(2)]
    wanted = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    distance, closest = cKDTree(places).query(wanted)
    return np.asarray(places[np.unique(closest[distance < step / 2])])


def _driven(scheme: Scheme, target: Target) -> Sequence[DrivePattern]:
    """What a frame drives had the first scan shown the contact."""
    if isinstance(scheme, DrivePattern):
        return [scheme]
    if callable(scheme):
        return scheme(target.position)
    return [scheme.next([target] if turn else [], turn) for turn in range(scheme.scans)]
