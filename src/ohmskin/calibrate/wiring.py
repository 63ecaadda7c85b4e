"""Open, shorted and exchanged wires, and poor contacts: a scan of all pairs against a model of the sheet.

Every pair of electrodes is driven, and every terminal measured against the sink, driven ones included. Whatever the
sheet, that gives the two-terminal resistance F_ij of every pair. On a sheet in order it is what the model of the
untouched sheet says, but for a slowly varying conductivity and a series resistance at each electrode:

    F_ij = c G_ij + sum_k b_k dG_ij/db_k + r_i + r_j

Electrodes that nothing reaches are taken out first. Of the rest, the exchange of two wires or the bridge between two
that explains most of what is left over is put into the model, until nothing explains much; then each r_i is judged.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ohmskin.arrays import Floats
from ohmskin.calibrate.wiring_fit import EXPLAINS, MOST_FAULTS, WiringFit, WiringSearch, typical_resistance
from ohmskin.errors import DataError
from ohmskin.scan import DrivePattern, Frame, all_pairs, n_pairs
from ohmskin.skin import Skin

_IDLE = 0.01  # share of the described current below which a pair carries none, whatever voltages its wires pick up
_SILENT = 0.1  # share of the typical signal below which nothing is connected
_CONTRADICTS = 0.03  # share of the typical voltage that may contradict every resistive network
_NONSENSE = 0.5  # the same above which the wiring is not diagnosed
_SHORT = 0.1  # share of a pair's modelled resistance below which a bridge is called a short
_POOR = 0.03  # series resistance above the others', as a share of a typical pair's, that makes a contact poor
_SPREAD = 5.0  # the same relative to what the sheet adds round the electrode, in standard deviations of the others
_UNEVEN = 150.0  # share by which conductivity close to an electrode may be off, in misfits; found on uneven sheets


@dataclass(frozen=True)
class WiringFinding:
    """A fault of the wiring.

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
class WiringDiagnosis:
    """Diagnosis of wiring and sheet from a scan of all pairs.

    Args:
        findings: The faults, by electrode.
        pair_resistances: (n_pairs,) measured two-terminal resistances (ohm), NaN where an electrode cannot be used.
        modelled: (n_pairs,) those of the model with this wiring (ohm), NaN likewise.
        conductivity: Sheet conductivity that fits (S per square).
        series: (n_elec,) series resistance at each electrode beyond the model's (ohm), NaN likewise.
        misfit: Root mean square of measured less modelled, as a share of the modelled resistance.
        contradiction: Root mean square voltage that no resistive network explains, as a share of the signal.
    """

    findings: tuple[WiringFinding, ...]
    pair_resistances: Floats
    modelled: Floats
    conductivity: float
    series: Floats
    misfit: float
    contradiction: float


def terminal_pattern(n_elec: int) -> DrivePattern:
    """Drives every pair and measures every terminal against the sink: n_elec (n_elec - 1)^2 / 2 voltages."""
    pairs = all_pairs(n_elec)
    others = np.array([[e for e in range(n_elec) if e != sink] for _, sink in pairs])
    which = np.repeat(np.arange(len(pairs)), n_elec - 1)
    return DrivePattern(pairs, np.column_stack([which, others.ravel(), np.repeat(pairs[:, 1], n_elec - 1)]))


def diagnose(skin: Skin, frame: Frame) -> WiringDiagnosis:
    """Diagnose faults of the wiring of an untouched skin.

    Args:
        skin: Its description.
        frame: A scan of `terminal_pattern`, preferably a mean of several.

    Raises:
        DataError: If the frame was made with another pattern.
    """
    n_elec = len(skin.electrodes)
    if frame.pattern != terminal_pattern(n_elec):
        raise DataError(f"the wiring is diagnosed from terminal_pattern({n_elec}); this frame has another pattern")
    findings = _unreached(frame, skin)
    nothing, nowhere, nan = np.full(n_pairs(n_elec), np.nan), np.full(n_elec, np.nan), float("nan")
    if findings and findings[0].kind == "silent":
        return WiringDiagnosis(findings, nothing, nothing, nan, nowhere, nan, nan)
    findings = (*findings, *_out_of_range(frame, [e for f in findings for e in f.electrodes], n_elec))
    contradicting, measured, contradiction = _network(frame, [e for f in findings for e in f.electrodes], n_elec)
    findings = (*findings, *contradicting)
    useless = sorted(e for f in findings for e in f.electrodes)
    alive = np.array([e for e in range(n_elec) if e not in useless])
    if len(alive) < 4 or contradiction > _NONSENSE:
        return WiringDiagnosis(findings, measured, nothing, nan, nowhere, nan, contradiction)
    usable = np.isin(all_pairs(n_elec), alive).all(axis=1)
    fit = WiringSearch(skin, alive, measured[usable]).best()
    findings = tuple(sorted((*findings, *_misplaced(fit, alive)), key=lambda finding: finding.electrodes))
    modelled, series = nothing.copy(), nowhere.copy()
    modelled[usable], series[alive] = fit.predicted, fit.series
    conductivity = skin.sheet.conductivity / fit.scale
    if not conductivity > 0:
        words = "no sheet of the described shape conducts like this: is it the skin described, with its own electrodes?"
        if (measured[usable] < 0).all():
            words = "every voltage has the wrong sign; swap the signs of voltages or currents in the device"
        findings = (*findings, WiringFinding("contradicts", (), words))
    return WiringDiagnosis(findings, measured, modelled, conductivity, series, fit.misfit, contradiction)


def potentials(frame: Frame, n_elec: int) -> Floats:
    """Potential (n_inj, n_elec) of every terminal against the sink (V); NaN where it is not known."""
    which, plus, _ = frame.pattern.measurements.T
    volts = np.zeros((frame.pattern.n_inj, n_elec))
    volts[which, plus] = np.where(np.isfinite(frame.voltages), frame.voltages, np.nan)
    return volts


def _unreached(frame: Frame, skin: Skin) -> tuple[WiringFinding, ...]:
    """Electrodes that give no current to any other: driving them, all the rest of the sheet is at one potential."""
    injections, n_elec = frame.pattern.injections, len(skin.electrodes)
    signal = np.full(len(injections), np.nan)
    for k, (row, driven) in enumerate(zip(potentials(frame, n_elec), injections, strict=True)):
        rest = np.delete(row, driven)
        rest = rest[np.isfinite(rest)]
        if len(rest) > n_elec / 2:  # the median, as a loose wire among the rest may pick up anything
            signal[k] = np.median(np.abs(rest - np.median(rest)))
    # a sheet without a way back follows the source but carries nothing; loose wires pick up anything
    currents = np.nan_to_num(frame.currents)
    idle = currents < _IDLE * _described_current(skin)
    signal[idle | (np.isnan(signal) & (currents < _SILENT * np.median(currents)))] = 0.0
    best = np.array([np.nanmax(signal[(injections == e).any(axis=1)], initial=0.0) for e in range(n_elec)])
    if best.max() <= 0 or (best < _SILENT * best.max()).mean() > 0.5:
        words = "almost no voltage on any electrode: check the source, the multiplexers and the plug of the skin"
        return (WiringFinding("silent", tuple(range(n_elec)), words),)
    return tuple(
        WiringFinding("open", (e,), f"electrode {e} is open")
        for e in np.flatnonzero(best < _SILENT * np.median(best)).tolist()
    )


def _described_current(skin: Skin) -> float:
    """The current of a typical pair of the untouched skin as described (A)."""
    source, limit = skin.source, skin.excitation.current_limit
    if source is None:
        return min(skin.excitation.amplitude, limit)
    return min(source.amplitude / (typical_resistance(skin) + source.resistance), limit)


def _out_of_range(frame: Frame, useless: list[int], n_elec: int) -> Iterator[WiringFinding]:
    """Electrodes that leave the converter's range whenever they are driven."""
    volts, injections = potentials(frame, n_elec), frame.pattern.injections
    clipped = ~np.isfinite(volts[np.arange(len(injections)), injections[:, 0]])
    usable = ~np.isin(injections, useless).any(axis=1)
    shares = {e: clipped[usable & (injections == e).any(axis=1)] for e in range(n_elec) if e not in useless}
    for e, own in shares.items():
        if own.size and own.mean() > 0.9:
            words = f"electrode {e} leaves the converter's range whenever it is driven"
            yield WiringFinding("out of range", (e,), f"{words}: a very poor contact, or too large a current")


def _network(frame: Frame, useless: list[int], n_elec: int) -> tuple[list[WiringFinding], Floats, float]:
    """The pair resistances (n_pairs,) of the best resistive network, what contradicts it, and the share left."""
    pattern = frame.pattern
    currents = frame.measurement_currents
    known = np.isfinite(frame.voltages) & np.isfinite(currents) & (currents > 0)
    volts = np.where(known, frame.voltages, 0.0)
    rows = pattern.combination(n_elec)
    findings: list[WiringFinding] = []
    out = list(useless)

    def fit(left_out: list[int]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        kept = known & ~pattern.uses(left_out)
        pairs = np.asarray(~np.isin(all_pairs(n_elec), left_out).any(axis=1))
        design = rows[kept][:, pairs].multiply(currents[kept][:, None] / np.median(currents[kept])).tocsr()
        solution = np.full(n_pairs(n_elec), np.nan)
        normal = (design.T @ design).toarray()
        solution[pairs] = np.linalg.lstsq(normal, design.T @ volts[kept], rcond=1e-10)[0]
        return solution / np.median(currents[kept]), volts[kept] - design @ solution[pairs], kept

    while True:
        resistances, left, kept = fit(out)
        signal = float(np.sqrt(np.mean(volts[kept] ** 2)))
        rms = float(np.sqrt(np.mean(left**2)))
        alive = [e for e in range(n_elec) if e not in out]
        if rms <= _CONTRADICTS * signal or len(alive) <= 4 or len(findings) >= MOST_FAULTS:
            return findings, resistances, rms / signal
        without = {e: fit([*out, e])[1] for e in alive}
        worst = min(alive, key=lambda e: float(np.mean(without[e] ** 2)))
        if np.mean(without[worst] ** 2) > EXPLAINS * rms**2:
            words = f"all voltages contradict each other by {100 * rms / signal:.2g} %"
            finding = WiringFinding("contradicts", (), f"{words}: does something touch the skin, or move it?")
            return [*findings, finding], resistances, rms / signal
        words = f"electrode {worst} measures voltages that contradict all others, though it carries current"
        findings.append(WiringFinding("contradicts", (worst,), f"{words}: check its sense wire"))
        out.append(worst)


def _misplaced(fit: WiringFit, alive: NDArray[np.int64]) -> Iterator[WiringFinding]:
    """Exchanged wires, bridges and poor contacts; `alive` (n,) names the electrodes of the fit."""
    order = fit.wiring.order
    count, cycle_of = connected_components(sp.eye_array(len(order), format="csr")[list(order)])
    for cycle in (np.flatnonzero(cycle_of == k) for k in range(count)):
        names = tuple(alive[cycle].tolist())
        if len(names) == 1:
            continue
        if len(names) == 2:
            words = f"electrodes {names[0]} and {names[1]} are swapped"
        else:
            goes = ", ".join(f"wire {alive[k]} is on electrode {alive[order[k]]}" for k in cycle)
            words = f"electrodes {', '.join(map(str, names))} are mixed up: {goes}"
        yield WiringFinding("swapped", names, words)
    typical = float(np.median(fit.unbridged))
    shorted: set[int] = set()  # through a short, the contacts of both are seen in parallel
    for (a, b), ohms, own_ohms in fit.bridges:
        names = (int(alive[a]), int(alive[b]))
        words = f"electrodes {names[0]} and {names[1]} are"
        if ohms < _SHORT * typical:
            shorted |= {a, b}
        if ohms < _SHORT * own_ohms:
            yield WiringFinding("shorted", names, f"{words} shorted together", ohms)
        else:
            yield WiringFinding(
                "bridged", names, f"{words} bridged by about {ohms:.2g} ohm: moisture, a stray strand?", ohms
            )
    # conductivity close to an electrode acts like its contact, the more so the more of the resistance lies there
    above, own = fit.series - np.median(fit.series), fit.series / fit.around
    own = own - np.median(own)
    least = max(_SPREAD * 1.4826 * float(np.median(np.abs(own))), _UNEVEN * fit.misfit)
    for t in np.flatnonzero((above > _POOR * typical) & (own > least)).tolist():
        if t not in shorted:
            words = f"electrode {alive[t]} has a poor contact: about {above[t]:.2g} ohm more than the others"
            yield WiringFinding("high", (int(alive[t]),), words, float(above[t]))
