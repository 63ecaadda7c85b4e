"""Array types of the whole package, and arrays as JSON has them."""

import math
from collections.abc import Callable, Mapping
from functools import cache, cached_property, wraps
from typing import Any, Self, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Shorts = NDArray[np.int32]
Bools = NDArray[np.bool_]
K = TypeVar("K")
V = TypeVar("V")


def real(given: ArrayLike, what: str, error: type[Exception]) -> Floats:
    """What was given as an array of floats, not copied where it is one already.

    Raises:
        error: If it is not numeric, or complex: `what` is said of it.
    """
    try:
        array = np.asarray(given)
        if array.dtype.kind == "c":
            raise error(f"{what} complex; only resistive skins are modelled: give real parts, or magnitudes")
        return np.asarray(array, float)
    except (TypeError, ValueError) as cause:
        if isinstance(cause, error):
            raise
        raise error(f"{what} of type {type(given).__name__}; give real numbers") from None


def quiet_nans(values: NDArray[Any]) -> Floats:
    """Numbers from outside as floats of their own: a signalling NaN, which would warn wherever it goes, is quiet."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values.astype(float) * 1.0)


class WeakCache(WeakKeyDictionary[K, V]):
    """What was worked out of something, as long as that is in use; a pickle leaves it out."""

    def __reduce__(self) -> tuple[type[Self], tuple[()]]:
        return type(self), ()


def fixed(compute: Callable[[Any], Floats]) -> "cached_property[Floats]":
    """A cached property that is a read-only array."""

    @wraps(compute)
    def read_only(self: Any) -> Floats:
        array = compute(self)
        array.setflags(write=False)
        return array

    return cached_property(read_only)


class ReadOnly:
    """Arrays that an object has when it is restored from a pickle are read-only, as they were."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        lock(self)


def changed(value: V, **fields: object) -> V:
    """A dataclass with other values of some fields, taken as they are: `dataclasses.replace` of a frame's values, of
    which there are many, in a tenth of its time."""
    other = object.__new__(type(value))
    own = vars(other)
    own.update(vars(value), **fields)
    for name in _cached_names(type(value)):  # type: ignore[arg-type]
        own.pop(name, None)
    return other


@cache
def _cached_names(kind: type[Any]) -> tuple[str, ...]:
    """The names of what objects of a class have worked out of their fields and keep."""
    return tuple(name for each in kind.mro() for name, one in vars(each).items() if isinstance(one, cached_property))


def lock(something: object) -> None:
    """Make the arrays that an object has read-only."""
    for value in vars(something).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)


def as_plain(value: Any) -> Any:
    """The value as JSON has it: arrays as lists, keys as texts, numbers that are not finite as None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): as_plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
