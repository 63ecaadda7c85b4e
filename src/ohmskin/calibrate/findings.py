"""What a scan of all pairs says about the wiring and the sheet."""

from dataclasses import dataclass

from ohmskin.arrays import Floats


@dataclass(frozen=True)
class Finding:
    """Something wrong with the wiring.

    Args:
        kind: "open", "shorted", "bridged", "swapped", "high", "contradicts", "out of range" or "silent".
        electrodes: Those concerned.
        text: The finding in plain words.
        value: Of a short or bridge its resistance, of a poor contact the resistance above the others' (ohm); else NaN.
    """

    kind: str
    electrodes: tuple[int, ...]
    text: str
    value: float = float("nan")

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a scan of all pairs says about the wiring and the sheet.

    Args:
        findings: What is wrong, by electrode.
        pair_resistances: (n_pairs,) measured two-terminal resistances (ohm), NaN where an electrode is of no use.
        modelled: (n_pairs,) what the model says of a skin wired like this (ohm), NaN likewise.
        conductivity: Sheet conductivity that fits (S per square).
        series: (n_elec,) series resistance at each electrode beyond the model's (ohm), NaN likewise.
        misfit: Root mean square of measured less modelled, as a share of the modelled resistance.
        contradiction: Root mean square voltage that no resistive network explains, as a share of the signal.
    """

    findings: tuple[Finding, ...]
    pair_resistances: Floats
    modelled: Floats
    conductivity: float
    series: Floats
    misfit: float
    contradiction: float
