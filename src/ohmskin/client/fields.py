"""The fields of a contact. Recordings, exports, boards, JSON and ROS messages are all made from this one table.

On the sheet (two dimensions) a contact is an `ohmskin.contacts.Contact`, in a frame of the robot (three) a
`ohmskin.client.Contact`. What is not known of one is None in Python, NaN in binary formats and null in JSON.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import isnan, nan
from typing import Any

_AXES = "xyz"


@dataclass(frozen=True)
class Field:
    """One field of a contact.

    Args:
        name: The attribute's name.
        unit: SI unit; empty for a plain number.
        meaning: In a few words, for definitions of messages.
        rank: 0 for a number, 1 for a vector, 2 for a symmetric matrix, of which the upper triangle is kept.
        ros: Type of a vector in ROS messages.
        optional: Whether it may be unknown.
        space: Whether there is one in a frame of the robot only, not on the sheet.
        flag: Whether it is true or false: 1 or 0 among numbers.
    """

    name: str
    unit: str
    meaning: str
    rank: int = 0
    ros: str = "geometry_msgs/Vector3"
    optional: bool = False
    space: bool = False
    flag: bool = False

    def components(self, dimensions: int) -> tuple[str, ...]:
        """Names of its numbers: ``extent``; ``velocity_x``, ...; ``covariance_xx``, ``covariance_xy``, ..."""
        axes = _AXES[:dimensions]
        if self.rank == 0:
            return (self.name,)
        if self.rank == 1:
            return tuple(axes if self.name == "position" else (f"{self.name}_{a}" for a in axes))
        return tuple(f"{self.name}_{a}{b}" for i, a in enumerate(axes) for b in axes[i:])

    def numbers(self, contact: Any, dimensions: int) -> list[float]:
        """Its numbers in the order of `components`; NaN where it is not known."""
        if (value := getattr(contact, self.name)) is None:
            return [nan] * (1, dimensions, dimensions * (dimensions + 1) // 2)[self.rank]
        if self.rank == 2:
            return [value[i][j] for i in range(dimensions) for j in range(i, dimensions)]
        return list(value) if self.rank else [float(value) if self.flag else value]

    def value(self, numbers: Mapping[str, float], dimensions: int) -> Any:
        """The attribute's value, the inverse of `numbers`; None if it is not known."""
        own = [numbers.get(component, nan) for component in self.components(dimensions)]
        if self.optional and any(isnan(number) for number in own):
            return None
        if self.rank == 2:
            upper = iter(own)
            pairs = {(i, j): next(upper) for i in range(dimensions) for j in range(i, dimensions)}
            return tuple(tuple(pairs[min(i, j), max(i, j)] for j in range(dimensions)) for i in range(dimensions))
        return tuple(own) if self.rank else bool(own[0]) if self.flag else own[0]


FIELDS = (
    Field("id", "", "stays while the contact lasts; counted by each skin for itself"),
    Field("position", "m", "", 1, "geometry_msgs/Point"),
    Field("normal", "", "outward", 1, space=True),
    Field("extent", "m2", "area above half the peak"),
    Field("strength", "m2", "integral of the relative conductivity change over the extent; not a force"),
    Field("confidence", "", "0 to 1"),
    Field("peak", "", "largest relative conductivity change"),
    Field("radius", "m", "of the disc that explains the data best; NaN if not known", optional=True),
    Field("velocity", "m/s", "NaN if not known", 1, optional=True),
    Field("covariance", "m2", "of the position; NaN if not known", 2, optional=True),
    Field("force", "N", "NaN if the skin is not calibrated for force, or it is not known yet", optional=True),
    Field("force_std", "N", "standard deviation of the force; NaN likewise", optional=True),
    Field("pressure", "Pa", "the greatest; NaN likewise, or if the calibration does not determine it", optional=True),
    Field("area", "m2", "force over pressure; NaN likewise", optional=True),
    Field("self_touch", "", "1: another link touches here, 0: none; NaN if not known", 0, "", True, True, True),
)
"""All fields, in the order of every binary format; on the sheet there are fewer."""


@cache
def fields(dimensions: int) -> tuple[Field, ...]:
    """The fields of a contact on the sheet (2) or in space (3)."""
    return tuple(field for field in FIELDS if dimensions == 3 or not field.space)


def components(dimensions: int) -> tuple[str, ...]:
    """Names of all numbers of a contact: ``id``, ``x``, ``y``, ..."""
    return tuple(component for field in fields(dimensions) for component in field.components(dimensions))


def columns() -> tuple[str, ...]:
    """`components` on the sheet with their units, for tables: ``x_m``, ``velocity_x_m_per_s``, ..."""
    return tuple(
        f"{component}_{field.unit.replace('/', '_per_')}" if field.unit else component
        for field in fields(2)
        for component in field.components(2)
    )


def as_number(value: float | None) -> float:
    """A number as records have it: NaN where it is not known."""
    return nan if value is None else value


def known(value: float) -> float | None:
    """What a number of a record says: None where it is not known; the inverse of `as_number`."""
    return None if isnan(value) else value


def numbers(contact: Any, dimensions: int) -> list[float]:
    """All numbers of a contact, in the order of `components`; the first one, the id, is an integer."""
    return [number for field in fields(dimensions) for number in field.numbers(contact, dimensions)]


def attributes(numbers: Mapping[str, float], dimensions: int) -> dict[str, Any]:
    """The attributes of a contact, by name, from its numbers by the names of `components`; the inverse of `numbers`."""
    return {field.name: field.value(numbers, dimensions) for field in fields(dimensions)}


def as_json(contact: Any) -> dict[str, Any]:
    """A contact on the sheet as JSON: vectors as lists, a covariance as [xx, xy, yy], null where not known."""
    found: dict[str, Any] = {}
    for field in fields(2):
        own = field.numbers(contact, 2)
        found[field.name] = None if any(isnan(number) for number in own) else own if field.rank else own[0]
    return found


def definition(dimensions: int) -> str:
    """The fields as lines of a ROS message definition."""
    lines = []
    for field in fields(dimensions):
        kind = "int32" if field.name == "id" else "float64"
        if field.rank == 1 and dimensions == 3:
            named = [f"{field.ros} {field.name}"]
        else:
            named = [f"{kind} {component}" for component in field.components(dimensions)]
        comment = ", ".join(text for text in (field.unit, field.meaning) if text)
        lines += [f"{line}  # {comment}" for line in named]
    return "\n".join(lines) + "\n"
