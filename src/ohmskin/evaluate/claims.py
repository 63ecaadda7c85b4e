"""The paper's claims, held against what was measured."""

from collections.abc import Sequence

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
from ohmskin.evaluate.statistics import Estimate, median, ratio_of_means
from ohmskin.evaluate.verdict import NO, OPEN, SURE, YES, Claim, above, ladder, ordered
from ohmskin.evaluate.worlds import WORLDS

ADAPTIVE = ("16O", "16O fused")  # the paper's scheme to the letter, and with both scans fused
LADDERS = (("12B", "16B"), *(("16B", "16I", best) for best in ADAPTIVE))
FIGURES_OF_MERIT = (  # ours, the paper's name, its column in Table I, whether lower is better
    ("AR", "AR", 0, False),
    ("PE", "|PE|", 1, True),
    ("RES", "SR", 2, True),
    ("SD", "SD", 3, True),
    ("RNG", "R", 4, True),
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


def _say(keys: Sequence[str], middles: Sequence[Estimate], scale: float = 1.0, unit: str = "") -> str:
    return ", ".join(f"{key} {m.text(scale)}{unit}" for key, m in zip(keys, middles, strict=True))


def _row(key: str) -> int:
    return METHODS.index(key)


def _fig3(done: Done) -> list[Claim]:
    found = []
    for world, task, result in done.of("fig3"):

        def add(text: str, keys: Sequence[str], values: Sequence[Floats], lower: bool = True, at: str = world) -> None:
            verdict, middles = ladder(values, lower)
            found.append(Claim("fig3", at, text, _SHOWN, _say(keys, middles, 1e3, " mm"), verdict))

        truth = np.array([contacts[0].position for contacts in task.cases])
        error = np.linalg.norm(result["place"] - truth[:, None, None], axis=-1)  # (n_cases, n_methods, n_seeds)
        error = np.where(np.isfinite(error), error, CENTRE)
        for best in ADAPTIVE:
            keys = ("12B", "16B", "16I", best)
            text = f"each method images single touches better than the one before, {best} best"
            add(f"{text} (mean localisation error)", keys, [error.mean(axis=0)[_row(k)] for k in keys])
        centre, rim = list(SINGLE).index("centre"), list(SINGLE).index("near the rim")
        text = "electrodes inside the sheet improve the image in the centre (localisation error there)"
        add(text, ("16B", "16I"), [error[centre, _row("16B")], error[centre, _row("16I")]])
        gain = [error[c, _row("12B")] - error[c, _row("16B")] for c in (centre, rim)]
        text = "more electrodes on the rim help near the rim more than in the centre"
        add(f"{text} (fall of the localisation error, 12B to 16B)", ("centre", "near the rim"), gain, False)
    return found


def _fig4(done: Done) -> list[Claim]:
    found = []
    for world, task, result in done.of("fig4"):
        wanted = np.array([len(contacts) for contacts in task.cases])
        right = (result["count"] == wanted[:, None, None]).mean(axis=0)  # (n_methods, n_seeds)
        placed = np.where(np.isfinite(result["error"]), result["error"], 0.1).mean(axis=0)
        theirs = right[_row("16I")]
        for best in ADAPTIVE:
            keys = ("16I", best)
            ratio = ratio_of_means(right[_row(best)], theirs) if theirs.any() else Estimate(0, 0, 0)
            shares = ", ".join(f"{k} {100 * right[_row(k)].mean():.0f} %" for k in keys)
            text = f"{best} finds the right number of touches at least as often as adjacent drive"
            text, here = f"{text} (all {len(SEVERAL)} cases)", f"{shares}; ratio {ratio.text()}"
            found.append(Claim("fig4", world, text, _SHOWN, here, above(ratio, 1.0)))
            verdict, middles = ladder([placed[_row(k)] for k in keys])
            text = f"{best} places several touches better than adjacent drive"
            text = f"{text} (mean distance; 100 mm where some are not found)"
            found.append(Claim("fig4", world, text, _SHOWN, _say(keys, middles, 1e3, " mm"), verdict))
    return found


def _fig5(done: Done) -> list[Claim]:
    measures = (("peak", "highest", 1.0, "", False), ("width", "narrowest", 1e3, " mm", True))
    found = []
    for world, _, result in done.of("fig5"):
        for name, better, scale, unit, lower in measures:
            for best in ADAPTIVE:
                keys = ("12B", "16B", "16I", best)
                verdict, middles = ladder([result[name][_row(k)] for k in keys], lower)
                text = f"the section's {name} improves from each method to the next, {best} is the {better}"
                found.append(Claim("fig5", world, text, "shown as curves", _say(keys, middles, scale, unit), verdict))
    return found


def _table1(done: Done) -> list[Claim]:
    found = []
    for world, _, result in done.of("table1"):
        for name, theirs, number, lower in FIGURES_OF_MERIT:
            for definition, columns in _DEFINITIONS.items():
                if name not in columns:
                    continue
                values = np.abs(result[definition][..., columns.index(name)])
                metric = definition == "modern" and name in ("PE", "localisation")
                for keys in LADDERS:
                    verdict, middles = ladder([values[_row(k)] for k in keys], lower)
                    published, note = "not in the table", _dependence(done, world, name, keys, lower, definition)
                    if number is not None:
                        figures = {
                            k.removesuffix(" fused"): abs(paper.TABLE[k.removesuffix(" fused")][number]) for k in keys
                        }
                        published = ", ".join(f"{k} {figure:g}" for k, figure in figures.items())
                        if not ordered([np.array([figure]) for figure in figures.values()], lower):
                            note = f"The paper's own figures do not have this order. {note}"
                    how = ", as EIDORS computes it" if definition == "eidors" else ""
                    text = f"{theirs} improves from {' to '.join(keys)}{how}"
                    here = _say(keys, middles, 1e3 if metric else 1.0, " mm" if metric else "")
                    key = name in ("PE", "SD", "RNG", "localisation") if len(keys) == 3 else name == "AR"
                    key = key and world == "discs" and definition == "modern"
                    found.append(Claim("table1", world, text, published, here, verdict, note.strip(), key))
    return found


def orders(
    done: Done, world: str, name: str, keys: Sequence[str], lower: bool, definition: str = "modern"
) -> dict[tuple[float, float], bool]:
    """Whether the medians have an order at each noise level and prior amplitude of the sweep."""
    column = _DEFINITIONS[definition].index(name)
    return {
        (task.decibels, task.amplitude): ordered([np.abs(result[definition][_row(k), :, column]) for k in keys], lower)
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


def _fig6(done: Done) -> list[Claim]:
    found = []
    for world, task, result in done.of("fig6"):
        overlap = {key: result["overlap"][:, m] for m, key in enumerate(task.methods)}  # (n_contacts, n_seeds) each
        for best in ADAPTIVE:
            pair = [overlap["16I"], overlap[best]]
            verdict, middles = ladder([each.mean(axis=0) for each in pair], lower_is_better=False)
            single = [ladder([pair[0][c], pair[1][c]], False)[0] for c in range(len(SHAPES))]
            note = "By shape: " + ", ".join(f"{kind} {v}" for kind, v in zip(SHAPES, single, strict=True)) + "."
            text = f"{best} shows contact shapes better than adjacent drive"
            text, here = f"{text} (intersection over union, mean of five shapes)", _say(("16I", best), middles)
            found.append(Claim("fig6", world, text, _SHOWN, here, verdict, note, best == "16O"))
        for c, kind in enumerate(SHAPES):
            if kind != "disc":  # a disc is not told from a disc
                score, blind = median(overlap["16O fused"][c]), float(result["blind"][c])
                text = (
                    f"the image reflects the shape: 16O fused scores more on the {kind} than the best disc in its place"
                )
                here = f"16O fused {score.text()}, best disc {blind:.3g}"
                found.append(Claim("fig6", world, text, _SHOWN, here, above(score, blind)))
    return found


def _fig7(done: Done) -> list[Claim]:
    found = []
    for world, _, result in done.of("fig7"):
        mean = errors(result).mean(axis=2)  # (n_methods, n_seeds)
        for best in ADAPTIVE:
            ratio = ratio_of_means(mean[_row("16I")], mean[_row(best)])
            means = ", ".join(f"{k} {1e3 * mean[_row(k)].mean():.2f} mm" for k in ("16I", best))
            text = f"{best} localises at least {paper.RATIO:.2f} times better than adjacent drive"
            text = f"{text}, at {float(result['decibels']):g} dB"
            theirs, here = f"13.01 / 10.23 mm = {paper.RATIO:.3f}", f"{means}; ratio {ratio.text()}"
            verdict, note = above(ratio, paper.RATIO), _ratios(done, world, best)
            found.append(Claim("fig7", world, text, theirs, here, verdict, note, True))
    return found


def _ratios(done: Done, world: str, best: str) -> str:
    ratios: dict[str, float] = {}
    for _, task, result in done.of("sweep", f"localisation/{world}/"):
        mean = errors(result).mean(axis=(1, 2))
        ratios[f"{task.decibels:g} dB, s = {task.amplitude:g}"] = float(mean[_row("16I")] / mean[_row(best)])
    if len(ratios) < 2:
        return ""
    least, most = min(ratios, key=lambda k: ratios[k]), max(ratios, key=lambda k: ratios[k])
    good = sum(value >= paper.RATIO for value in ratios.values())
    return (
        f"Depends on noise and prior amplitude: in the sweep the ratio goes from {ratios[least]:.2f} ({least}) to "
        f"{ratios[most]:.2f} ({most}) and reaches the paper's at {good} of {len(ratios)} settings."
    )


def _fig8(done: Done) -> list[Claim]:
    found = []
    for world in WORLDS:
        for level in dict.fromkeys((done.settings.noise[0], done.settings.fine_noise)):
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
                    text = f"{key} tells contacts {theirs * 1e3:.0f} mm apart from one by {by}, {level:g} dB"
                    sure = np.mean(limit.resampled[row] <= theirs) >= SURE
                    verdict = (YES if sure else OPEN) if limit.overall[row] <= theirs else NO
                    published, key_claim = f"{theirs * 1e3:.0f} mm", world == "pressed"
                    found.append(Claim("fig8", world, text, published, here, verdict, note, key_claim))
    return found


def _mm(distance: float) -> str:
    return f"{distance * 1e3:.0f} mm" if np.isfinite(distance) else "none up to 60 mm"
