"""Contacts as a vector of fixed length, for what learns: points, the strongest first, zeros where there are fewer."""

from collections.abc import Sequence
from typing import Any

_POINT = ("present", "x", "y", "z", "strength", "force")


def point_names(most: int) -> list[str]:
    """Names of the numbers of `points`: ``contact_0.present``, ``contact_0.x`` (m), ... ``contact_0.force`` (N), ..."""
    return [f"contact_{number}.{name}" for number in range(most) for name in _POINT]


def points(contacts: Sequence[Any], most: int) -> list[float]:
    """Numbers (6 most,) of the strongest contacts of a robot (`ohmskin.client.Contact`).

    Each is 1, its place (m) in its frame, its strength (m2), and its force (N), which is 0 where it is not known. A
    contact that is not there is six zeros.
    """
    strongest = sorted(contacts, key=lambda contact: -contact.strength)[:most]
    told = [[1.0, *one.position, one.strength, one.force or 0.0] for one in strongest]
    return [number for row in told for number in row] + [0.0] * (len(_POINT) * (most - len(told)))
