"""The paper's claims, held against what was measured."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate import paper
from ohmskin.evaluate.experiments.localisation import CENTRE, errors
from ohmskin.evaluate.experiments.touches import COLUMNS, EIDORS_COLUMNS
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.plan import SEVERAL, SINGLE, Settings
from ohmskin.evaluate.resolution import limits
from ohmskin.evaluate.result import Outcome
from ohmskin.evaluate.shapes import SHAPES
from ohmskin.evaluate.statistics import ConfidenceInterval, median, ratio_of_means
from ohmskin.evaluate.verdict import NO, OPEN, SURE, YES, Claim, above, ladder, ordered
from ohmskin.evaluate.worlds import WORLDS

ADAPTIVE = ("16O", "16O fused")  # the paper's scheme to the letter, and with both scans fused
LADDERS = (("12B", "16B"), *(("16B", "16I", best) for best in ADAPTIVE))
FIGURES_OF_MERIT = (  # key, name, column in Table I, whether lower is better
    ("AR", "AR", 0, False),
    ("PE", "|PE|", 1, True),
    ("RES", "RES", 2, True),
    ("SD", "SD", 3, True),
    ("RNG", "RNG", 4, True),
    ("localisation", "localisation", None, True),
)
DECIDED_BY = {"dip": "the dip between two peaks", "test": "the test of two contacts against one"}
_DEFINITIONS: dict[str, tuple[str, ...]] = {"modern": COLUMNS, "eidors": EIDORS_COLUMNS}
_SHOWN = "shown as pictures"
Done = Outcome[Settings]


def assess(done: Done) -> list[Claim]:
    """The verdicts on all claims that the results at hand can decide."""
    claims = {"fig3": _fig3, "fig4": _fig4, "fig5": _fig5, "table1": _table1, "fig6": _fig6, "fig7": _fig7}
    claims |= {"fig8": _fig8}
    return [claim for figure, find in claims.items() if figure in done.results for claim in find(done)]


def _ordered(
    figure: str, world: str, text: str, values: Mapping[str, Floats], lower: bool = True, mm: bool = False, **more: Any
) -> Claim:
    """The claim that the values (n_seeds,) of each method are better than those of the one before."""
    verdict, middles = ladder(list(values.values()), lower)
    texts = (f"{m.text(1e3)} mm" if mm else m.text() for m in middles)
    here = ", ".join(map(" ".join, zip(values, texts, strict=True)))
    return Claim(figure, world, text, here=here, verdict=verdict, **{"paper": _SHOWN} | more)


def _of(keys: Sequence[str], values: Floats) -> dict[str, Floats]:
    """Values (n_methods, ...) of some methods."""
    return {key: values[METHODS.index(key)] for key in keys}


def _fig3(done: Done) -> Iterator[Claim]:
    for world, task, result in done.of("fig3"):
        truth = np.array([contacts[0].position for contacts in task.cases])
        error = np.linalg.norm(result["place"] - truth[:, None, None], axis=-1)  # (n_cases, n_methods, n_seeds)
        error = np.where(np.isfinite(error), error, CENTRE)
        for best in ADAPTIVE:
            text = f"each method images single touches better than the one before, {best} best"
            values = _of(("12B", "16B", "16I", best), error.mean(axis=0))
            yield _ordered("fig3", world, f"{text} (mean localisation error)", values, mm=True)
        centre = error[list(SINGLE).index("centre")]
        text = "electrodes inside the sheet improve the image in the centre (localisation error there)"
        yield _ordered("fig3", world, text, _of(("16B", "16I"), centre), mm=True)
        fall = error[:, METHODS.index("12B")] - error[:, METHODS.index("16B")]
        gain = {place: fall[list(SINGLE).index(place)] for place in ("centre", "near the rim")}
        text = "more electrodes on the rim help near the rim more than in the centre"
        text = f"{text} (fall of the localisation error, 12B to 16B)"
        yield _ordered("fig3", world, text, gain, False, True)


def _fig4(done: Done) -> Iterator[Claim]:
    for world, task, result in done.of("fig4"):
        wanted = np.array([len(contacts) for contacts in task.cases])
        right = (result["count"] == wanted[:, None, None]).mean(axis=0)  # (n_methods, n_seeds)
        placed = np.where(np.isfinite(result["error"]), result["error"], 0.1).mean(axis=0)
        for best in ADAPTIVE:
            theirs, ours = _of(("16I", best), right).values()
            ratio = ratio_of_means(ours, theirs) if theirs.any() else ConfidenceInterval(0, 0, 0)
            text = f"{best} finds the right number of touches at least as often as adjacent drive"
            here = f"16I {100 * theirs.mean():.0f} %, {best} {100 * ours.mean():.0f} %; ratio {ratio.text()}"
            yield Claim("fig4", world, f"{text} (all {len(SEVERAL)} cases)", _SHOWN, here, above(ratio, 1.0))
            text = f"{best} places several touches better than adjacent drive"
            text = f"{text} (mean distance; 100 mm where some are not found)"
            yield _ordered("fig4", world, text, _of(("16I", best), placed), mm=True)


def _fig5(done: Done) -> Iterator[Claim]:
    for world, _, result in done.of("fig5"):
        for name, better, *how in (("peak", "highest", False), ("width", "narrowest", True, True)):
            for best in ADAPTIVE:
                values = _of(("12B", "16B", "16I", best), result[name])
                text = f"the section's {name} improves from each method to the next, {best} is the {better}"
                yield _ordered("fig5", world, text, values, *how, paper="shown as curves")


def _table1(done: Done) -> Iterator[Claim]:
    for (world, _, result), (name, theirs, number, lower) in product(done.of("table1"), FIGURES_OF_MERIT):
        for (definition, columns), keys in product(_DEFINITIONS.items(), LADDERS):
            if name not in columns:
                continue
            values = _of(keys, np.abs(result[definition][..., columns.index(name)]))
            published, note = "not in the table", _dependence(done, world, name, keys, lower, definition)
            if number is not None:
                names = [key.removesuffix(" fused") for key in keys]
                figures = {key: abs(paper.TABLE[key][number]) for key in names}
                published = ", ".join(f"{key} {figure:g}" for key, figure in figures.items())
                if not ordered([np.array([figure]) for figure in figures.values()], lower):
                    note = f"The paper's own figures do not have this order. {note}"
            modern = definition == "modern"
            text = f"{theirs} improves from {' to '.join(keys)}{'' if modern else ', as EIDORS computes it'}"
            mm = modern and name in ("PE", "localisation")
            key = name in ("PE", "SD", "RNG", "localisation") if len(keys) == 3 else name == "AR"
            key = key and world == "discs" and modern
            more = {"paper": published, "note": note.strip(), "key": key}
            yield _ordered("table1", world, text, values, lower, mm, **more)


def orders(
    done: Done, world: str, name: str, keys: Sequence[str], lower: bool, definition: str = "modern"
) -> dict[tuple[float, float], bool]:
    """Whether the medians have an order at each noise level and prior amplitude of the sweep."""
    column = _DEFINITIONS[definition].index(name)
    return {
        (task.decibels, task.amplitude): ordered([*_of(keys, np.abs(result[definition][..., column])).values()], lower)
        for _, task, result in done.of("sweep", f"merits/{world}/")
    }


def _dependence(done: Done, world: str, name: str, keys: Sequence[str], lower: bool, definition: str) -> str:
    """How an order of medians fares over the sweep, in a sentence; empty without one."""
    holds = orders(done, world, name, keys, lower, definition)
    good = sum(holds.values())
    if len(holds) < 2:
        return ""
    if good in (0, len(holds)):
        return f"The medians have this order at {'all' if good else 'none'} of the {len(holds)} settings of the sweep."
    where = f"the medians have this order at {good} of {len(holds)} settings of the sweep"
    return f"Depends on noise and prior amplitude: {where}."


def _fig6(done: Done) -> Iterator[Claim]:
    for world, task, result in done.of("fig6"):
        overlap = {key: result["overlap"][:, m] for m, key in enumerate(task.methods)}  # (n_contacts, n_seeds) each
        for best in ADAPTIVE:
            pair = {key: overlap[key] for key in ("16I", best)}
            single = [ladder([each[c] for each in pair.values()], False)[0] for c in range(len(SHAPES))]
            note = "By shape: " + ", ".join(f"{kind} {v}" for kind, v in zip(SHAPES, single, strict=True)) + "."
            text = f"{best} shows contact shapes better than adjacent drive"
            text = f"{text} (intersection over union, mean of five shapes)"
            means = {key: each.mean(axis=0) for key, each in pair.items()}
            yield _ordered("fig6", world, text, means, False, note=note, key=best == "16O")
        for c, kind in enumerate(SHAPES):
            if kind != "disc":  # a disc is not told from a disc
                score, blind = median(overlap["16O fused"][c]), float(result["blind"][c])
                text = f"the image reflects the shape: 16O fused scores more on the {kind}"
                text = f"{text} than the best disc in its place"
                here = f"16O fused {score.text()}, best disc {blind:.3g}"
                yield Claim("fig6", world, text, _SHOWN, here, above(score, blind))


def _fig7(done: Done) -> Iterator[Claim]:
    for world, _, result in done.of("fig7"):
        mean = errors(result).mean(axis=2)  # (n_methods, n_seeds)
        for best in ADAPTIVE:
            each = _of(("16I", best), mean)
            ratio = ratio_of_means(*each.values())
            means = ", ".join(f"{key} {1e3 * values.mean():.2f} mm" for key, values in each.items())
            text = f"{best} localises at least {paper.RATIO:.2f} times better than adjacent drive"
            text = f"{text}, at {float(result['decibels']):g} dB"
            theirs, here = f"13.01 / 10.23 mm = {paper.RATIO:.3f}", f"{means}; ratio {ratio.text()}"
            verdict, note = above(ratio, paper.RATIO), _ratios(done, world, best)
            yield Claim("fig7", world, text, theirs, here, verdict, note, True)


def _ratios(done: Done, world: str, best: str) -> str:
    ratios: dict[str, float] = {}
    for _, task, result in done.of("sweep", f"localisation/{world}/"):
        mean = errors(result).mean(axis=(1, 2))
        ratios[f"{task.decibels:g} dB, s = {task.amplitude:g}"] = float(np.divide(*_of(("16I", best), mean).values()))
    if len(ratios) < 2:
        return ""
    least, most = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    good = sum(value >= paper.RATIO for value in ratios.values())
    return (
        f"Depends on noise and prior amplitude: in the sweep the ratio goes from {ratios[least]:.2f} ({least}) to "
        f"{ratios[most]:.2f} ({most}) and reaches the paper's at {good} of {len(ratios)} settings."
    )


def _fig8(done: Done) -> Iterator[Claim]:
    for world, level in product(WORLDS, dict.fromkeys((done.settings.noise[0], done.settings.fine_noise))):
        areas = list(done.of("fig8", f"{world}/{level:g}/"))
        task = areas[0][1]
        for how, by in DECIDED_BY.items():
            limit = limits(task.distances, [result for _, _, result in areas], how)
            for row, key in enumerate(task.methods):
                theirs = paper.DISCRIMINATION[key.removesuffix(" fused")]
                low, high = np.quantile(limit.resampled[row], [0.025, 0.975], method="nearest")
                by_area = ", ".join(_mm(d) for d in limit.by_area[row])
                spread = f" ({_mm(low)} to {_mm(high)})" if low < high else ""
                here = f"{_mm(limit.overall[row])}{spread}; by area {by_area}"
                note = f"Takes single contacts for two in {100 * limit.false[row]:.1f} % of trials."
                text = f"{key} distinguishes contacts {theirs * 1e3:.0f} mm apart from one by {by}, {level:g} dB"
                sure = np.mean(limit.resampled[row] <= theirs) >= SURE
                verdict = (YES if sure else OPEN) if limit.overall[row] <= theirs else NO
                yield Claim("fig8", world, text, f"{theirs * 1e3:.0f} mm", here, verdict, note, world == "pressed")


def _mm(distance: float) -> str:
    return f"{distance * 1e3:.0f} mm" if np.isfinite(distance) else "none up to 60 mm"
