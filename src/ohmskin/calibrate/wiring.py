"""Which wires are off, touching, exchanged or in poor contact, told from a scan of all pairs against a model of the sheet.

Every pair of electrodes is driven, and every terminal measured against the sink, driven ones included. Whatever the sheet, that
gives the two-terminal resistance F_ij of every pair. On a sheet in order it is what the model of the untouched sheet says, but for
a slowly varying conductivity and a series resistance at each electrode:

    F_ij = c G_ij + sum_k b_k dG_ij/db_k + r_i + r_j

Electrodes that nothing reaches are taken out first. Of the rest, the exchange of two wires or the bridge between two that
explains most of what is left over is put into the model, again and again until nothing explains much; then each r_i is judged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.geometry import mesh_domain
from ohmskin.geometry.domain import Floats
from ohmskin.scan import DrivePattern, Frame, all_pairs, n_pairs
from ohmskin.skin import Skin

_IDLE = 0.01  # share of the described current below which a pair carries none, whatever voltages its wires pick up
_SILENT = 0.1  # share of the typical signal below which nothing is connected
_CONTRADICTS = 0.03  # share of the typical voltage that may contradict every resistive network
_NONSENSE = 0.5  # the same from which on nothing more is told of the wiring
_SEARCH = 3e-3  # relative misfit below which the wiring is as the model says; mesh and noise leave 1e-3
_EXPLAINS = 0.7  # share of the squared misfit that an exchange must not leave
_EXPLAINS_LITTLE = 0.9  # the same of a bridge, which is seen in its own pair first
_BRIDGED = 0.6  # share of its modelled resistance below which a pair may be bridged
_SURELY = 0.12  # the same, below which it is; an exchange of wires does not get there
_SHORT = 0.1  # the same, from which on a bridge is called a short
_POOR = 0.03  # series resistance above the others', as a share of a typical pair's, that makes a contact poor
_SPREAD = 5.0  # the same relative to what the sheet adds round the electrode, in standard deviations of the others
_OHMS = 1e-2  # the least that a bridge may have (ohm)
_MOST_OHMS = 4.0  # the most, as a share of the resistance measured across it
_UNEVEN = 150.0  # share by which conductivity close to an electrode may be off, in misfits; found on sheets uneven by chance
_CANDIDATES = 4  # looked at closely
_LEAK = 1.5  # resistance of a bridge, as a share of the pair's, above which it is none
_MOST_FAULTS = 6
_MESH = 0.55  # the estimator's edge length times this resolves the electrodes


@dataclass(frozen=True)
class Finding:
    """Something wrong with the wiring.

    Args:
        kind: "open", "shorted", "bridged", "swapped", "high", "contradicts", "out of range" or "silent".
        electrodes: Those concerned.
        text: The finding in plain words.
        value: Of a short or bridge its resistance, of a poor contact the resistance above the others' (ohm); otherwise NaN.
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


def terminal_pattern(n_elec: int) -> DrivePattern:
    """Drives every pair and measures every terminal against the sink: n_elec (n_elec - 1)^2 / 2 voltages."""
    pairs = all_pairs(n_elec)
    others = np.array([[e for e in range(n_elec) if e != sink] for _, sink in pairs])
    which = np.repeat(np.arange(len(pairs)), n_elec - 1)
    return DrivePattern(pairs, np.column_stack([which, others.ravel(), np.repeat(pairs[:, 1], n_elec - 1)]))


def diagnose(skin: Skin, frame: Frame) -> Diagnosis:
    """Find what is wrong with the wiring of an untouched skin.

    Args:
        skin: What it should be.
        frame: A scan of `terminal_pattern`, best a mean of several.

    Raises:
        DataError: If the frame was made with another pattern.
    """
    n_elec = len(skin.electrodes)
    if frame.pattern != terminal_pattern(n_elec):
        raise DataError(f"the wiring is told from terminal_pattern({n_elec}); this frame has another pattern")
    findings = _unreached(frame, skin)
    nothing = np.full(n_pairs(n_elec), np.nan)
    if findings and findings[0].kind == "silent":
        return Diagnosis(findings, nothing, nothing, float("nan"), np.full(n_elec, np.nan), float("nan"), float("nan"))
    findings = (*findings, *_out_of_range(frame, [e for f in findings for e in f.electrodes], n_elec))
    contradicting, measured, contradiction = _network(frame, [e for f in findings for e in f.electrodes], n_elec)
    findings = (*findings, *contradicting)
    useless = sorted(e for f in findings for e in f.electrodes)
    alive = np.array([e for e in range(n_elec) if e not in useless])
    if len(alive) < 4 or contradiction > _NONSENSE:
        return Diagnosis(findings, measured, nothing, float("nan"), np.full(n_elec, np.nan), float("nan"), contradiction)
    model = _SheetModel(skin, alive)
    wired = model.explain(measured[model.pairs_of_all(n_elec)])
    findings = (*findings, *wired.findings(alive))
    modelled, series = nothing.copy(), np.full(n_elec, np.nan)
    modelled[model.pairs_of_all(n_elec)], series[alive] = wired.predicted, wired.series
    ordered = tuple(sorted(findings, key=lambda finding: finding.electrodes))
    return Diagnosis(ordered, measured, modelled, skin.sheet.conductivity / wired.scale, series, wired.misfit, contradiction)


def _potentials(frame: Frame, n_elec: int) -> Floats:
    """Potential (n_inj, n_elec) of every terminal against the sink (V); NaN where it is not known."""
    which, plus, _ = frame.pattern.measurements.T
    volts = np.zeros((frame.pattern.n_inj, n_elec))
    volts[which, plus] = np.where(np.isfinite(frame.voltages), frame.voltages, np.nan)
    return volts


def _unreached(frame: Frame, skin: Skin) -> tuple[Finding, ...]:
    """Electrodes that give no current to any other: driving them, all the rest of the sheet is at one potential."""
    injections, n_elec = frame.pattern.injections, len(skin.electrodes)
    signal = np.full(len(injections), np.nan)
    for k, (row, driven) in enumerate(zip(_potentials(frame, n_elec), injections, strict=True)):
        rest = np.delete(row, driven)
        rest = rest[np.isfinite(rest)]
        if len(rest) > n_elec / 2:  # the median, as a loose wire among the rest may pick up anything
            signal[k] = np.median(np.abs(rest - np.median(rest)))
    # a sheet without a way back follows the source, perhaps out of range, but carries nothing; loose wires pick up anything
    currents = np.nan_to_num(frame.currents)
    idle = currents < _IDLE * _described_current(skin)
    signal[idle | (np.isnan(signal) & (currents < _SILENT * np.median(currents)))] = 0.0
    best = np.array([np.nanmax(signal[(injections == e).any(axis=1)], initial=0.0) for e in range(n_elec)])
    if best.max() <= 0 or (best < _SILENT * best.max()).mean() > 0.5:
        words = "hardly a voltage anywhere on the sheet: check the source, the multiplexers and the plug of the skin"
        return (Finding("silent", tuple(range(n_elec)), words),)
    return tuple(Finding("open", (e,), f"electrode {e} is open") for e in np.flatnonzero(best < _SILENT * np.median(best)).tolist())


def _described_current(skin: Skin) -> float:
    """The current of a typical pair of the untouched skin as described (A)."""
    source, limit = skin.source, skin.excitation.current_limit
    if source is None:
        return min(skin.excitation.amplitude, limit)
    _, columns = _sheet(skin)
    return min(source.amplitude / (float(np.median(columns[:, 0])) + source.resistance), limit)


def _out_of_range(frame: Frame, useless: list[int], n_elec: int) -> Iterator[Finding]:
    """Electrodes that leave the converter's range whenever they are driven."""
    volts, injections = _potentials(frame, n_elec), frame.pattern.injections
    clipped = ~np.isfinite(volts[np.arange(len(injections)), injections[:, 0]])
    usable = ~np.isin(injections, useless).any(axis=1)
    shares = {e: clipped[usable & (injections == e).any(axis=1)] for e in range(n_elec) if e not in useless}
    for e, own in shares.items():
        if own.size and own.mean() > 0.9:
            words = f"electrode {e} leaves the converter's range whenever it is driven: a very poor contact, or too large a current"
            yield Finding("out of range", (e,), words)


def _network(frame: Frame, useless: list[int], n_elec: int) -> tuple[list[Finding], Floats, float]:
    """The pair resistances (n_pairs,) of the best resistive network, what contradicts it, and how much is left of the signal."""
    pattern = frame.pattern
    currents = frame.currents[pattern.measurements[:, 0]]
    known = np.isfinite(frame.voltages) & np.isfinite(currents) & (currents > 0)
    volts = np.where(known, frame.voltages, 0.0)
    rows = pattern.combination(n_elec)
    findings: list[Finding] = []
    out = list(useless)

    def fit(left_out: list[int]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        kept = known & ~np.isin(pattern.quadruples, left_out).any(axis=1)
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
        if rms <= _CONTRADICTS * signal or len(alive) <= 4 or len(findings) >= _MOST_FAULTS:
            return findings, resistances, rms / signal
        without = {e: fit([*out, e])[1] for e in alive}
        worst = min(alive, key=lambda e: float(np.mean(without[e] ** 2)))
        if np.mean(without[worst] ** 2) > _EXPLAINS * rms**2:
            words = f"all voltages contradict each other by {100 * rms / signal:.2g} %: does something touch the skin, or move it?"
            return [*findings, Finding("contradicts", (), words)], resistances, rms / signal
        words = f"electrode {worst} measures voltages that contradict all others, though it carries current: check its sense wire"
        findings.append(Finding("contradicts", (worst,), words))
        out.append(worst)


@dataclass(frozen=True, eq=False)
class _Wired:
    """A way that the electrodes may be wired, fitted: to which electrode each terminal goes, and which terminals are bridged."""

    order: tuple[int, ...]
    bridges: tuple[tuple[int, int], ...] = ()
    ohms: tuple[float, ...] = ()
    scale: float = 1.0
    series: Floats | None = None  # by terminal
    around: Floats | None = None  # by terminal: the modelled resistance from it to all others
    predicted: Floats | None = None
    unbridged: Floats | None = None
    squares: float = np.inf
    misfit: float = np.inf

    def findings(self, alive: NDArray[np.int64]) -> Iterator[Finding]:
        assert self.series is not None
        assert self.unbridged is not None
        assert self.around is not None
        seen: set[int] = set()
        for terminal in range(len(self.order)):
            cycle = [terminal]
            while (following := self.order[cycle[-1]]) != terminal:
                cycle.append(following)
            names = tuple(sorted(int(alive[k]) for k in cycle))
            if len(cycle) > 1 and terminal not in seen:
                seen.update(cycle)
                if len(names) == 2:
                    words = f"electrodes {names[0]} and {names[1]} are swapped"
                else:
                    goes = ", ".join(f"wire {alive[k]} is on electrode {alive[self.order[k]]}" for k in sorted(cycle))
                    words = f"electrodes {', '.join(map(str, names))} are mixed up: {goes}"
                yield Finding("swapped", names, words)
        pairs = all_pairs(len(self.order))
        typical = float(np.median(self.unbridged))
        for (a, b), ohms in zip(self.bridges, self.ohms, strict=True):
            names = (int(alive[a]), int(alive[b]))
            if ohms < _SHORT * float(self.unbridged[((pairs == (a, b)).all(axis=1))][0]):
                yield Finding("shorted", names, f"electrodes {names[0]} and {names[1]} are shorted together", ohms)
            else:
                words = f"electrodes {names[0]} and {names[1]} are bridged by about {ohms:.2g} ohm: moisture, a stray strand?"
                yield Finding("bridged", names, words, ohms)
        # conductivity close to an electrode acts like its contact, the more so the more of the resistance lies there
        above, own = self.series - np.median(self.series), self.series / self.around
        own = own - np.median(own)
        least = max(_SPREAD * 1.4826 * float(np.median(np.abs(own))), _UNEVEN * self.misfit)
        shorted = [t for bridge, ohms in zip(self.bridges, self.ohms, strict=True) if ohms < _SHORT * typical for t in bridge]
        for t in np.flatnonzero((above > _POOR * typical) & (own > least)).tolist():
            if t not in shorted:  # through a short, the contacts of both are seen in parallel
                words = f"electrode {alive[t]} has a poor contact: about {above[t]:.2g} ohm more than the others"
                yield Finding("high", (int(alive[t]),), words, float(above[t]))


@lru_cache(maxsize=4)
def _sheet(skin: Skin) -> tuple[Floats, Floats]:
    """Of the untouched sheet as described: resistance (n_elec,) from each electrode to all others, and columns (n_pairs, 6).

    The columns are the pair resistances, and what they change by with a conductivity that varies linearly and quadratically.
    """
    electrodes = skin.electrodes.with_discs(skin.electrode.radius, skin.electrode.contact_resistivity)
    mesh = mesh_domain(skin.domain, _MESH * skin.imaging.mesh_size)
    model = TransferModel(mesh, electrodes, skin.sheet.conductivity)
    i, j = all_pairs(len(electrodes)).T
    s = model.transfer_resistance
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    x, y = ((mesh.centroids - (low + high) / 2) / ((high - low).max() / 2)).T
    slow = np.column_stack([x, y, x * x, x * y, y * y]) * model.conductivity[:, None]
    return np.diag(s).copy(), np.column_stack([s[i, i] + s[j, j] - 2 * s[i, j], model.pair_sensitivity @ slow])


class _SheetModel:
    """Pair resistances of the electrodes that are of use, and how they change with a slowly varying conductivity."""

    def __init__(self, skin: Skin, alive: NDArray[np.int64]) -> None:
        self.alive = alive
        self.n = len(alive)
        self.pairs = all_pairs(self.n)
        around, columns = _sheet(skin)
        columns = columns[self.pairs_of_all(len(skin.electrodes))]
        if len(self.pairs) < 3 * (self.n + 6):  # else the slow changes would explain everything
            columns = columns[:, :1]
        ends = np.zeros((len(self.pairs), self.n))
        ends[np.arange(len(self.pairs))[:, None], self.pairs] = 1.0
        self.resistances: Floats = columns[:, 0]
        self.around: Floats = around[alive]
        self.n_sheet = columns.shape[1]
        self.design = np.hstack([columns, ends])

    def pairs_of_all(self, n_all: int) -> NDArray[np.bool_]:
        """Which pairs (n_pairs of all electrodes,) are of use."""
        return np.asarray(np.isin(all_pairs(n_all), self.alive).all(axis=1))

    def explain(self, measured: Floats) -> _Wired:
        """The wiring that explains the measured resistances (n_pairs of `alive`,) best without inventing faults."""
        best = self._fit(measured, self._with_shorts(measured))
        if len(self.pairs) < 2 * self.design.shape[1] - self.n_sheet:
            return best  # too few electrodes to tell one fault from another
        for _ in range(_MOST_FAULTS):
            if best.misfit <= _SEARCH:
                break
            tried = [
                self._fit(measured, other) for other in [*self._bridged_more(measured, best), *self._exchanged(measured, best)]
            ]
            worth = [
                other
                for other in tried
                if other.squares < (_EXPLAINS if other.bridges == best.bridges else _EXPLAINS_LITTLE) * best.squares
                and self._leaks_only(other)
            ]
            if not worth:
                break
            best = min(worth, key=lambda wired: wired.squares)
        return best

    def _ratios(self, measured: Floats) -> Floats:
        ratios: Floats = measured / self.resistances
        return ratios / float(np.median(ratios))

    def _with_shorts(self, measured: Floats) -> _Wired:
        """Straight wires, and a bridge where two electrodes are so close that no exchange of wires explains it."""
        bridges: list[tuple[int, int]] = []
        ohms: list[float] = []
        joined = np.arange(self.n)
        ratios = self._ratios(measured)
        for k in np.argsort(ratios).tolist():
            a, b = self.pairs[k].tolist()
            if ratios[k] < _SURELY and joined[a] != joined[b]:  # of three shorted together, two bridges say it all
                joined[joined == joined[b]] = joined[a]
                bridges.append((a, b))
                ohms.append(float(measured[k]))
        return _Wired(tuple(range(self.n)), tuple(bridges), tuple(ohms))

    def _bridged_more(self, measured: Floats, wired: _Wired) -> Iterator[_Wired]:
        """The same wiring with one bridge more, the likeliest."""
        ratios = self._ratios(measured)
        bridged = {t for bridge in wired.bridges for t in bridge}
        low = [k for k in np.argsort(ratios).tolist() if ratios[k] < _BRIDGED and not bridged & set(self.pairs[k].tolist())]
        for k in low[:_CANDIDATES]:
            a, b = self.pairs[k].tolist()
            yield replace(wired, bridges=(*wired.bridges, (a, b)), ohms=(*wired.ohms, float(measured[k])))

    def _exchanged(self, measured: Floats, wired: _Wired) -> list[_Wired]:
        """The same wiring with two wires exchanged, the likeliest if what the bridges do stays as it is."""
        assert wired.predicted is not None
        assert wired.unbridged is not None
        corrected, weight = measured - (wired.predicted - wired.unbridged), 1 / self.resistances
        bridged = [t for bridge in wired.bridges for t in bridge]
        kept = ~np.isin(self.pairs, bridged).any(axis=1)
        found = []
        for a, b in self.pairs[kept].tolist():
            order = list(wired.order)
            order[a], order[b] = order[b], order[a]
            design = self._design(order)[kept] * weight[kept, None]
            free = np.linalg.lstsq(design, corrected[kept] * weight[kept], rcond=None)[0]
            left = design @ free - corrected[kept] * weight[kept]
            found.append((float(left @ left), replace(wired, order=tuple(order))))
        return [other for _, other in sorted(found, key=lambda pair: pair[0])[:_CANDIDATES]]

    def _leaks_only(self, wired: _Wired) -> bool:
        """Whether every bridge carries a good part of its pair's current."""
        assert wired.unbridged is not None
        of = [wired.unbridged[(self.pairs == bridge).all(axis=1)][0] for bridge in wired.bridges]
        return all(ohms < _LEAK * own for ohms, own in zip(wired.ohms, of, strict=True))

    def _fit(self, measured: Floats, wired: _Wired) -> _Wired:
        """Scale, slow changes, series resistances and bridges that fit best, relative to the modelled resistances."""
        design, weight = self._design(wired.order), 1 / self.resistances
        free = np.asarray(np.linalg.lstsq(design * weight[:, None], measured * weight, rcond=None)[0], float)
        ohms: Floats = np.array(wired.ohms)
        across = [float(measured[(self.pairs == bridge).all(axis=1)][0]) for bridge in wired.bridges]
        bounds = np.log(_OHMS), np.log(_MOST_OHMS * np.maximum(across, _OHMS))  # as the pair is in parallel to its bridge
        if wired.bridges:
            start = np.concatenate(
                [self._undisturbed(measured, wired, design, weight), np.clip(np.log(np.maximum(ohms, _OHMS)), *bounds)]
            )

            def residual(values: Floats) -> Floats:
                resistances = design @ values[: design.shape[1]]
                bridges = np.exp(np.clip(values[design.shape[1] :], *bounds))
                out: Floats = (_bridged(resistances, wired.bridges, bridges) - measured) * weight
                return out

            # scaled by what they do: a conductivity, and ohms
            scales = np.concatenate([np.ones(self.n_sheet), np.full(self.n, 100.0), np.ones(len(ohms))])
            solved = least_squares(residual, start, x_scale=scales, max_nfev=15).x
            free = np.asarray(solved[: design.shape[1]], float)
            ohms = np.asarray(np.exp(np.clip(solved[design.shape[1] :], *bounds)), float)
        unbridged = design @ free
        predicted = _bridged(unbridged, wired.bridges, ohms)
        squares = float(np.sum(((predicted - measured) * weight) ** 2))
        spare = max(1, len(measured) - design.shape[1] - len(ohms))
        return replace(
            wired,
            ohms=tuple(ohms.tolist()),
            scale=float(free[0]),
            series=free[self.n_sheet :],
            around=self.around[list(wired.order)],
            predicted=predicted,
            unbridged=unbridged,
            squares=squares,
            misfit=float(np.sqrt(squares / spare)),
        )

    def _design(self, order: Sequence[int]) -> Floats:
        """The design (n_pairs, n_params) if terminal k is wired to electrode order[k]; series resistances stay the terminals'."""
        index = np.zeros((self.n, self.n), np.int64)
        index[self.pairs[:, 0], self.pairs[:, 1]] = index[self.pairs[:, 1], self.pairs[:, 0]] = np.arange(len(self.pairs))
        to = np.array(order)
        rows = index[to[self.pairs[:, 0]], to[self.pairs[:, 1]]]
        return np.hstack([self.design[rows, : self.n_sheet], self.design[:, self.n_sheet :]])

    def _undisturbed(self, measured: Floats, wired: _Wired, design: Floats, weight: Floats) -> Floats:
        """Where to start: the fit without the pairs of bridged terminals."""
        kept = np.asarray(~np.isin(self.pairs, [t for bridge in wired.bridges for t in bridge]).any(axis=1))
        return np.asarray(np.linalg.lstsq(design[kept] * weight[kept, None], measured[kept] * weight[kept], rcond=None)[0], float)


def _bridged(resistances: Floats, bridges: Sequence[tuple[int, int]], ohms: Floats) -> Floats:
    """Pair resistances (n_pairs,) with some terminals bridged."""
    if not bridges:
        return resistances
    n = round((1 + np.sqrt(1 + 8 * len(resistances))) / 2)
    i, j = all_pairs(n).T
    gram = np.zeros((n, n))
    gram[i, j] = gram[j, i] = -resistances / 2
    for (a, b), r in zip(bridges, ohms, strict=True):
        across = gram[:, a] - gram[:, b]
        gram = gram - np.outer(across, across) / max(across[a] - across[b] + r, 1e-9)
    own = np.diag(gram)
    pairs: Floats = own[i] + own[j] - 2 * gram[i, j]
    return pairs
