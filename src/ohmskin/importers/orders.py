"""The order of adjacent measurements where a file does not state it: found from the voltages, which are largest beside
the driven electrodes.

Electrodes are on a rim, in the order of their numbers; n drive their neighbours in turn. Voltages are between
neighbours, or of single electrodes against one that stays the same, of which neighbours' differences are taken.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from ohmskin.arrays import Bools, Floats, Ints

_BETTER = 0.005  # by which another order must be more alike than the usual one
_LEAST = 0.25  # likeness below which none is believed
_LEAST_ELECTRODES, _MOST_ELECTRODES = 4, 128

# whether values are of single electrodes; which are taken, and the electrodes at which none is, counted from the driven
# source; of neighbours the first of each pair
_FORMS: tuple[tuple[bool, str, tuple[int, ...]], ...] = (
    (False, "none at a driven electrode", (-1, 0, 1)),
    (False, "all", ()),
    (False, "all but the driven pair's", (0,)),
    (False, "none at the source", (-1, 0)),
    (False, "none at the sink", (0, 1)),
    (True, "all", ()),
    (True, "idle ones", (0, 1)),
)


@dataclass(frozen=True, eq=False)
class Order:
    """One order in which adjacent measurements may be written.

    Args:
        words: What it is.
        quadruples: (n, 4) source, sink, plus, minus.
        plus, minus: (n,) columns of the values whose difference each is; minus -1: the value itself.
    """

    words: str
    quadruples: Ints
    plus: Ints
    minus: Ints

    def volts(self, values: Floats) -> Floats:
        """Voltages (n_frames, n) of values (n_frames, n_values)."""
        return np.asarray(values[:, self.plus] - np.where(self.minus < 0, 0.0, values[:, self.minus]))

    @property
    def single(self) -> bool:
        """Whether the values are of single electrodes."""
        return bool((self.minus >= 0).any())

    @property
    def idle(self) -> Bools:
        """(n,) whether a voltage is between electrodes that carry no current."""
        a, b, c, d = self.quadruples.T
        return np.asarray((a != c) & (a != d) & (b != c) & (b != d))

    def similarity(self, sizes: Floats) -> float:
        """How sizes (n,) of voltages follow those of a round even sheet (1): the correlation of their logarithms, less
        where they vary more or less than there."""
        n_elec = self.quadruples.max() + 1
        source, sink, plus, minus = (np.exp(2j * np.pi * column / n_elec) for column in self.quadruples[self.idle].T)
        ratio = np.abs((plus - source) * (minus - sink) / ((minus - source) * (plus - sink)))
        there, here = np.log(np.abs(np.log(ratio))), sizes[self.idle]
        known = np.isfinite(here) & (here > 0)
        if known.sum() < 3 or not (there[known].std() and np.ptp(here[known])):
            return 0.0
        here, there = np.log(here[known]), there[known]
        slope = float(here.std() / there.std())
        return float(np.corrcoef(here, there)[0, 1]) * min(slope, 1 / slope)


def orders(count: int) -> list[Order]:
    """The orders in which a frame of so many values may be written, the usual ones first."""
    found = []
    for n_elec, (single, told, skipped) in product(range(_LEAST_ELECTRODES, _MOST_ELECTRODES + 1), _FORMS):
        if n_elec * (n_elec - len(skipped)) == count:
            found += [_order(n_elec, skipped, turning, single, told) for turning in (False, True)]
    return found


def likeliest(values: Floats) -> tuple[Order | None, str]:
    """The order that voltages, or changes of voltages, (n_frames, n_values) are in, None if they are too many or too
    few for adjacent drive; and a doubt in words, empty if there is none."""
    known = orders(values.shape[1])
    if not known:
        return None, ""
    likenesses = [one.similarity(_sizes(one.volts(values))) for one in known]
    best = int(np.argmax(likenesses))
    if likenesses[best] < likenesses[0] + _BETTER:
        best = 0
    if likenesses[best] < _LEAST:
        found = f"likeness {likenesses[best]:.2f} with a round even sheet"
        doubt = f"the voltages are not largest beside the driven electrodes ({found}); is it adjacent drive?"
        return known[best], doubt
    return known[best], ""


def _sizes(volts: Floats) -> Floats:
    return np.asarray(np.sqrt(np.ma.masked_invalid(volts**2).mean(axis=0).filled(np.nan)))


def _order(n_elec: int, skipped: tuple[int, ...], turning: bool, single: bool, note: str) -> Order:
    """Values of each injection from the electrode behind the sink on (`turning`), or in the order of their numbers."""
    rows, plus, minus, column = [], [], [], 0
    for source in range(n_elec):
        left_out = {(source + one) % n_elec for one in skipped}
        begin = source + max(skipped, default=-1) + 1 if turning else 0
        taken = [e for k in range(n_elec) if (e := (begin + k) % n_elec) not in left_out]
        where = {electrode: column + k for k, electrode in enumerate(taken)}
        for electrode in taken:
            behind = (electrode + 1) % n_elec
            if not single or behind in where:
                rows.append((source, (source + 1) % n_elec, electrode, behind))
                plus.append(where[electrode])
                minus.append(where[behind] if single else -1)
        column += len(taken)
    kind = "against a common electrode" if single else "between neighbours"
    begins = "from the driven electrodes on" if turning else "in the order of their numbers"
    return Order(f"voltages {kind} ({note}), {begins}", np.array(rows), np.array(plus), np.array(minus))
