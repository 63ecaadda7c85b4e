"""Which contacts are new, for a line each on the terminal or in a log."""

from collections.abc import Hashable, Mapping
from typing import TypeVar

_GONE_AFTER = 1.0  # s; longer than a contact goes unseen and keeps its id

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")


class Arrivals:
    """Finds contacts that were not there a moment ago; ids are counted anew after a calibration."""

    def __init__(self) -> None:
        self._last: dict[Hashable, float] = {}  # when each was seen last

    def new(self, time: float, contacts: Mapping[K, T]) -> list[T]:
        """Those of the contacts now (`time`, s), by id, that are new."""
        self._last = {key: seen for key, seen in self._last.items() if time - seen < _GONE_AFTER}
        new = [contact for key, contact in contacts.items() if key not in self._last]
        self._last |= dict.fromkeys(contacts, time)
        return new
