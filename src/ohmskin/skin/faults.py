"""What goes wrong between a skin and its instrument: wires come off, touch or are plugged in wrongly."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError

PICKUP = 0.05  # V rms that an unconnected wire picks up
# electrodes, what the number is
_KINDS = {"open": (1, ""), "short": (2, "ohms"), "swap": (2, ""), "high": (1, "factor")}
_RANGES = {"ohms": (0.0, 1e6), "factor": (1.0, 1e9)}
_USAGE = '"open 3", "short 7 8", "short 7 8 50" (ohms), "swap 1 2" or "high 5 20" (factor on the contact impedance)'


@dataclass(frozen=True)
class Fault:
    """A fault of the wiring. Electrodes are numbered from 0.

    Args:
        kind: "open": no connection; "short": two wires touch; "swap": two wires are exchanged; "high": a poor contact.
        electrodes: Those concerned, one or two.
        value: Of "short" the resistance of the bridge (ohm), of "high" the factor on the contact impedance.

    Raises:
        SkinError: If there is no such fault or a number is out of range.
    """

    kind: str
    electrodes: tuple[int, ...]
    value: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise SkinError(f"fault {self.kind!r}; choose from {', '.join(_KINDS)}: {_USAGE}")
        count, number = _KINDS[self.kind]
        if len(self.electrodes) != count or len(set(self.electrodes)) != count or min(self.electrodes) < 0:
            named = f"fault {self.kind!r} names electrodes {list(self.electrodes)}"
            raise SkinError(f"{named}; it takes {count}, such as {_USAGE}")
        low, high = _RANGES.get(number, (0.0, 0.0))
        if not low <= self.value <= high:
            told = f"fault {self.kind!r} has {number or 'a number'} {self.value:g}"
            raise SkinError(f"{told}; it must be {low:g} to {high:g}")

    @classmethod
    def parse(cls, text: str) -> "Fault":
        """Read a fault such as "open 3", "short 7 8", "short 7 8 50", "swap 1 2" or "high 5 20".

        Raises:
            SkinError: If the text is not one of these.
        """
        kind, *words = text.split() or [""]
        if kind not in _KINDS:
            raise SkinError(f"fault {text!r} is not known; it must be like {_USAGE}")
        count, number = _KINDS[kind]
        given = words[count:] or (["1"] if kind == "short" else [])
        try:
            electrodes, values = tuple(int(word) for word in words[:count]), [float(word) for word in given]
        except ValueError as error:
            raise SkinError(f"fault {text!r} has something that is not a number; it must be like {_USAGE}") from error
        if len(values) != bool(number):
            raise SkinError(f"fault {text!r} has {len(words)} numbers; it must be like {_USAGE}")
        return cls(kind, electrodes, *values)

    def __str__(self) -> str:
        return " ".join([self.kind, *map(str, self.electrodes), *([f"{self.value:g}"] if _KINDS[self.kind][1] else [])])


class Wiring:
    """The wires between electrodes and instrument, with their faults; poor contacts are the sheet's matter.

    Args:
        faults: Each electrode may be in one fault only.
        n_elec: How many electrodes there are.

    Attributes:
        open: Terminals without a wire.

    Raises:
        SkinError: If a fault names an electrode that is not there, or two faults name the same one.
    """

    def __init__(self, faults: Sequence[Fault], n_elec: int) -> None:
        named = [e for fault in faults for e in fault.electrodes]
        if named and max(named) >= n_elec:
            raise SkinError(f"a fault names electrode {max(named)}; there are {n_elec} (0..{n_elec - 1})")
        if twice := sorted(e for e in set(named) if named.count(e) > 1):
            raise SkinError(f"electrode {twice[0]} is in two faults; give one for each electrode")
        self.faults = tuple(faults)
        self.open = tuple(fault.electrodes[0] for fault in faults if fault.kind == "open")
        self.contact_factors = np.ones(n_elec)
        self._order = np.arange(n_elec)
        self._shorts: list[tuple[int, int, float]] = []
        for fault in faults:
            match fault.kind:
                case "high":
                    self.contact_factors[fault.electrodes[0]] = fault.value
                case "swap":
                    self._order[list(fault.electrodes)] = fault.electrodes[::-1]
                case "short":
                    self._shorts.append((fault.electrodes[0], fault.electrodes[1], fault.value))

    def seen_from_terminals(self, resistance: Floats) -> Floats:
        """Transfer resistances (n_elec, n_elec) between terminals, from those between electrodes (ohm)."""
        if not self.faults:
            return resistance
        seen: Floats = resistance[np.ix_(self._order, self._order)]
        for a, b, ohms in self._shorts:
            across = seen[:, a] - seen[:, b]  # a bridge is an update of rank one
            seen = seen - np.outer(across, across) / max(across[a] - across[b] + ohms, 1e-12)
        return seen
