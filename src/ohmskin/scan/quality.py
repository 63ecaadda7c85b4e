"""Data quality: what the data show of the electrodes, and weights that allow for it."""

from dataclasses import dataclass, replace

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.scan.baseline import Difference
from ohmskin.scan.frame import Frame


@dataclass(frozen=True)
class Verdict:
    """A fault of one electrode.

    Args:
        electrode: Its number, from 0.
        kind: ``open``, ``shorted``, ``missing``, ``clipped``, ``noisy`` or ``drifting``.
        weight: Weight of its measurements: 0: not used; else their error is 1 / weight times the others'.
        words: The finding in plain words.
    """

    electrode: int
    kind: str
    weight: float
    words: str


@dataclass(frozen=True)
class Quality:
    """Quality of data, assessed from the data alone.

    Args:
        n_elec: Number of electrodes.
        verdicts: One for each faulty electrode, by number.
        noise: Standard deviation of one voltage about the mean of repeated quiet frames (V); NaN without repeats.
        reciprocity: Standard deviation of one voltage about the best network, usable electrodes only (V); NaN where the
            pattern measures nothing twice.
        signal: Root mean square of the quiet voltages (V).
        errors: (n_elec,) reciprocity error of the measurements each electrode takes part in (V); NaN: not known.
        values: Number of values.
        missing: Number of NaN values.
        clipped: Number of infinite values, at the end of the converter's range.
    """

    n_elec: int
    verdicts: tuple[Verdict, ...]
    noise: float
    reciprocity: float
    signal: float
    errors: Floats
    values: int
    missing: int
    clipped: int

    @property
    def bad(self) -> tuple[int, ...]:
        """Electrodes whose measurements cannot be used."""
        return tuple(verdict.electrode for verdict in self.verdicts if verdict.weight == 0)

    @property
    def weights(self) -> Floats:
        """Weight (n_elec,) of each electrode, 0 to 1."""
        weights = np.ones(self.n_elec)
        for verdict in self.verdicts:
            weights[verdict.electrode] = verdict.weight
        return weights

    @property
    def findings(self) -> list[str]:
        """The fault of each electrode that has one, in words."""
        return [f"electrode {verdict.electrode}: {verdict.words}" for verdict in self.verdicts]

    def clean(self, frame: Frame) -> Frame:
        """The frame with every value that a bad electrode took part in left out (NaN)."""
        used = frame.pattern.uses(self.bad)
        return replace(frame, voltages=np.where(used, np.nan, frame.voltages)) if used.any() else frame

    def weigh(self, difference: Difference) -> Difference:
        """The difference with bad electrodes left out and doubtful ones at lower weight.

        A measurement with twice the
        error has the weight of one at half the current: current and voltage are scaled together, so that all have the
        same noise and every estimator can use them unchanged.
        """
        weight = self.weights[difference.pattern.quadruples].min(axis=1)
        weighed = difference.times(weight)
        return replace(weighed, volts=np.where(weight > 0, weighed.volts, np.nan))

    def report(self) -> list[str]:
        """The findings as sentences, one a line; the first is a summary."""
        used = [v.electrode for v in self.verdicts]
        all_well = f"all {self.n_elec} electrodes in order"
        state = f"{len(used)} of {self.n_elec} electrodes faulty" if used else all_well
        noise = [f"noise {in_words(self.noise)} from repeats"] if np.isfinite(self.noise) else []
        if np.isfinite(self.reciprocity):
            share = f" ({100 * self.reciprocity / self.signal:.2g} % of the signal)" if self.signal > 0 else ""
            noise.append(f"reciprocity error {in_words(self.reciprocity)}{share}")
        else:
            noise.append("reciprocity unknown: the pattern has no redundant measurements")
        lines = ["data quality: " + "; ".join([state, *noise])]
        if self.missing or self.clipped:
            part = 100 * (self.missing + self.clipped) / self.values
            count = f"{self.missing} values missing and {self.clipped} clipped"
            lines.append(f"{count} of {self.values} ({part:.2g} %), left out")
        return lines + self.findings


def left_out(difference: Difference) -> str:
    """How many measurements of a difference are not known, and at which electrodes; empty if all are."""
    unknown = ~(np.isfinite(difference.volts) & np.isfinite(difference.currents))
    if not unknown.any():
        return ""
    used = np.unique(difference.pattern.quadruples)
    share = np.array([unknown[difference.pattern.uses(e)].mean() for e in used])
    hit = [int(e) for e in used[share >= 0.999]] or [int(e) for e in used[share >= 0.9 * share.max()]]
    which = f"electrode{'s' if len(hit) > 1 else ''} {', '.join(str(e) for e in hit)}"
    return f"{int(unknown.sum())} of {len(unknown)} measurements left out, most at {which}"


def in_words(value: float, unit: str = "V") -> str:
    """A value with a prefix to its unit that suits it, such as "205 uV"."""
    if not np.isfinite(value) or value == 0:
        return f"{value:g} {unit}"
    sizes = ((1.0, ""), (1e-3, "m"), (1e-6, "u"))
    size, prefix = next((one for one in sizes if abs(value) >= 0.9995 * one[0]), (1e-9, "n"))
    return f"{value / size:.3g} {prefix}{unit}"
