"""The paper's claims, held against what was measured. Every verdict is computed; none is written down here."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from ohmskin.evaluate import paper
from ohmskin.evaluate.experiments import Discrimination, Touches
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.experiments.merits import COLUMNS, EIDORS_COLUMNS
from ohmskin.evaluate.methods import METHODS
from ohmskin.evaluate.plan import SEVERAL, SINGLE
from ohmskin.evaluate.reproduction import Reproduction
from ohmskin.evaluate.resolution import limits
from ohmskin.evaluate.shapes import SHAPES
from ohmskin.evaluate.statistics import Estimate, median, ratio_of_means
from ohmskin.evaluate.verdict import NO, YES, Claim, above, ladder, ordered
from ohmskin.evaluate.worlds import WORLDS, Contacts

ADAPTIVE = ("16O", "16O+")  # the paper's scheme to the letter, and with both scans fused
LADDERS = (("12B", "16B"), *(("16B", "16I", best) for best in ADAPTIVE))
FIGURES_OF_MERIT = (  # ours, the paper's name, its column in Table I, whether lower is better
    ("AR", "AR", 0, False),
    ("PE", "|PE|", 1, True),
    ("RES", "SR", 2, True),
    ("SD", "SD", 3, True),
    ("RNG", "R", 4, True),
    ("localisation", "localisation", None, True),
)
_DEFINITIONS: dict[str, tuple[str, ...]] = {"modern": COLUMNS, "eidors": EIDORS_COLUMNS}
_SHOWN = "shown as pictures"


def judge(done: Reproduction) -> list[Claim]:
    """The verdicts on all claims that the results at hand can decide."""
    judges = {
        "fig3": _fig3,
        "fig4": _fig4,
        "fig5": _fig5,
        "table1": _table1,
        "fig6": _fig6,
        "fig7": _fig7,
        "fig8": _fig8,
    }
    return [claim for figure, judged in judges.items() if figure in done.results for claim in judged(done)]


def _say(keys: Sequence[str], middles: Sequence[Estimate], scale: float = 1.0, unit: str = "") -> str:
    return ", ".join(f"{key} {m.text(scale)}{unit}" for key, m in zip(keys, middles, strict=True))


def _row(key: str) -> int:
    return METHODS.index(key)


def _cases(done: Reproduction, figure: str, world: str) -> tuple[Contacts, ...]:
    return cast(Touches, done.experiments[figure][world]).cases


def _fig3(done: Reproduction) -> list[Claim]:
    found = []
    for world, result in done.results["fig3"].items():
        truth = np.array([contacts[0].position for contacts in _cases(done, "fig3", world)])
        error = np.linalg.norm(result["place"] - truth[:, None, None], axis=-1)  # (n_cases, n_methods, n_seeds)
        error = np.where(np.isfinite(error), error, 0.1)
        for best in ADAPTIVE:
            keys = ("12B", "16B", "16I", best)
            verdict, middles = ladder([error.mean(axis=0)[_row(k)] for k in keys])
            text = f"each method images single touches better than the one before, {best} best (mean localisation error)"
            found.append(Claim("fig3", world, text, _SHOWN, _say(keys, middles, 1e3, " mm"), verdict))
        centre, rim = list(SINGLE).index("centre"), list(SINGLE).index("near the rim")
        verdict, middles = ladder([error[centre, _row("16B")], error[centre, _row("16I")]])
        text = "electrodes inside the sheet improve the image in the centre (localisation error there)"
        found.append(Claim("fig3", world, text, _SHOWN, _say(("16B", "16I"), middles, 1e3, " mm"), verdict))
        gain = [error[c, _row("12B")] - error[c, _row("16B")] for c in (centre, rim)]
        verdict, middles = ladder(gain, lower_is_better=False)
        text = "more electrodes on the rim help near the rim more than in the centre (fall of the localisation error, 12B to 16B)"
        found.append(Claim("fig3", world, text, _SHOWN, _say(("centre", "near the rim"), middles, 1e3, " mm"), verdict))
    return found


def _fig4(done: Reproduction) -> list[Claim]:
    found = []
    for world, result in done.results["fig4"].items():
        wanted = np.array([len(contacts) for contacts in _cases(done, "fig4", world)])
        right = (result["count"] == wanted[:, None, None]).mean(axis=0)  # (n_methods, n_seeds)
        placed = np.where(np.isfinite(result["error"]), result["error"], 0.1).mean(axis=0)
        for best in ADAPTIVE:
            keys = ("16I", best)
            ratio = ratio_of_means(right[_row(best)], right[_row("16I")]) if right[_row("16I")].any() else Estimate(0, 0, 0)
            shares = ", ".join(f"{k} {100 * right[_row(k)].mean():.0f} %" for k in keys)
            text = f"{best} finds the right number of touches at least as often as adjacent drive (all {len(SEVERAL)} cases)"
            found.append(Claim("fig4", world, text, _SHOWN, f"{shares}; ratio {ratio.text()}", above(ratio, 1.0)))
            verdict, middles = ladder([placed[_row(k)] for k in keys])
            text = f"{best} places several touches better than adjacent drive (mean distance; 100 mm where some are not found)"
            found.append(Claim("fig4", world, text, _SHOWN, _say(keys, middles, 1e3, " mm"), verdict))
    return found


def _fig5(done: Reproduction) -> list[Claim]:
    found = []
    for world, result in done.results["fig5"].items():
        for name, better, scale, unit, lower in (("peak", "highest", 1.0, "", False), ("width", "narrowest", 1e3, " mm", True)):
            for best in ADAPTIVE:
                keys = ("12B", "16B", "16I", best)
                verdict, middles = ladder([result[name][_row(k)] for k in keys], lower)
                text = f"the section's {name} improves from each method to the next, {best} is the {better}"
                found.append(Claim("fig5", world, text, "shown as curves", _say(keys, middles, scale, unit), verdict))
    return found


def _table1(done: Reproduction) -> list[Claim]:
    found = []
    for world, result in done.results["table1"].items():
        for name, theirs, number, lower in FIGURES_OF_MERIT:
            for definition, columns in _DEFINITIONS.items():
                if name not in columns:
                    continue
                values = np.abs(result[definition][..., columns.index(name)])
                metric = definition == "modern" and name in ("PE", "localisation")
                for keys in LADDERS:
                    verdict, middles = ladder([values[_row(k)] for k in keys], lower)
                    published, note = "not in the table", dependence(done, world, name, keys, lower, definition)
                    if number is not None:
                        figures = [abs(paper.TABLE[k.rstrip("+")][number]) for k in keys]
                        published = ", ".join(f"{k.rstrip('+')} {figure:g}" for k, figure in zip(keys, figures, strict=True))
                        if not ordered([np.array([figure]) for figure in figures], lower):
                            note = f"The paper's own figures do not have this order. {note}"
                    text = f"{theirs} improves from {' to '.join(keys)}" + (
                        ", as EIDORS computes it" if definition == "eidors" else ""
                    )
                    here = _say(keys, middles, 1e3 if metric else 1.0, " mm" if metric else "")
                    key = name in ("PE", "SD", "RNG", "localisation") if len(keys) == 3 else name == "AR"
                    key = key and world == "discs" and definition == "modern"
                    found.append(Claim("table1", world, text, published, here, verdict, note.strip(), key))
    return found


def orders(
    done: Reproduction, world: str, name: str, keys: Sequence[str], lower: bool, definition: str = "modern"
) -> dict[tuple[float, float], bool]:
    """Whether the medians have an order at each noise level and prior amplitude of the sweep."""
    columns = _DEFINITIONS[definition]
    found = {}
    for where, result in done.results.get("sweep", {}).items():
        what, at, decibels, amplitude = where.split("/")
        if (what, at) == ("merits", world):
            values = np.abs(result[definition][..., columns.index(name)])
            found[float(decibels), float(amplitude)] = ordered([values[_row(k)] for k in keys], lower)
    return found


def dependence(done: Reproduction, world: str, name: str, keys: Sequence[str], lower: bool, definition: str) -> str:
    """How an order of medians fares over the sweep, in a sentence; empty without one."""
    holds = orders(done, world, name, keys, lower, definition)
    good = sum(holds.values())
    if len(holds) < 2:
        return ""
    if good in (0, len(holds)):
        return f"The medians have this order at {'all' if good else 'none'} of the {len(holds)} settings of the sweep."
    return f"Depends on noise and prior amplitude: the medians have this order at {good} of {len(holds)} settings of the sweep."


def _fig6(done: Reproduction) -> list[Claim]:
    found = []
    result = done.results["fig6"]["pressed"]
    keys: tuple[str, ...] = getattr(done.experiments["fig6"]["pressed"], "methods")  # noqa: B009
    for best in ADAPTIVE:
        pair = [result["overlap"][:, keys.index(k)] for k in ("16I", best)]  # (n_contacts, n_seeds) each
        verdict, middles = ladder([each.mean(axis=0) for each in pair], lower_is_better=False)
        single = [ladder([pair[0][c], pair[1][c]], False)[0] for c in range(len(SHAPES))]
        note = "By shape: " + ", ".join(f"{kind} {v}" for kind, v in zip(SHAPES, single, strict=True)) + "."
        text = f"{best} shows contact shapes better than adjacent drive (intersection over union, mean of five shapes)"
        found.append(Claim("fig6", "pressed", text, _SHOWN, _say(("16I", best), middles), verdict, note, best == "16O"))
    for c, kind in enumerate(SHAPES):
        if kind != "disc":  # a disc is not told from a disc
            here, blind = median(result["overlap"][c, keys.index("16O+")]), float(result["blind"][c])
            text = f"the image reflects the shape: 16O+ scores more on the {kind} than the best disc in its place"
            found.append(Claim("fig6", "pressed", text, _SHOWN, f"16O+ {here.text()}, best disc {blind:.3g}", above(here, blind)))
    return found


def _fig7(done: Reproduction) -> list[Claim]:
    found = []
    for world, result in done.results["fig7"].items():
        mean = errors(result).mean(axis=2)  # (n_methods, n_seeds)
        for best in ADAPTIVE:
            ratio = ratio_of_means(mean[_row("16I")], mean[_row(best)])
            means = ", ".join(f"{k} {1e3 * mean[_row(k)].mean():.2f} mm" for k in ("16I", best))
            text = (
                f"{best} localises at least {paper.RATIO:.2f} times better than adjacent drive, at {float(result['decibels']):g} dB"
            )
            theirs, here = f"13.01 / 10.23 mm = {paper.RATIO:.3f}", f"{means}; ratio {ratio.text()}"
            found.append(Claim("fig7", world, text, theirs, here, above(ratio, paper.RATIO), _ratios(done, world, best), True))
    return found


def _ratios(done: Reproduction, world: str, best: str) -> str:
    ratios: dict[str, float] = {}
    for where, result in done.results.get("sweep", {}).items():
        what, at, decibels, amplitude = where.split("/")
        if (what, at) == ("localisation", world):
            mean = errors(result).mean(axis=2)
            ratios[f"{decibels} dB, s = {amplitude}"] = float(mean[_row("16I")].mean() / mean[_row(best)].mean())
    if len(ratios) < 2:
        return ""
    least, most = min(ratios, key=lambda k: ratios[k]), max(ratios, key=lambda k: ratios[k])
    good = sum(value >= paper.RATIO for value in ratios.values())
    return (
        f"Depends on noise and prior amplitude: in the sweep the ratio goes from {ratios[least]:.2f} ({least}) to "
        f"{ratios[most]:.2f} ({most}) and reaches the paper's at {good} of {len(ratios)} settings."
    )


_HOW = {"dip": "the dip between two peaks", "test": "the test of two discs against one"}


def _fig8(done: Reproduction) -> list[Claim]:
    found = []
    for world in WORLDS:
        for level in dict.fromkeys((done.settings.noise[0], done.settings.fine_noise)):
            names = [name for name in done.results["fig8"] if name.startswith(f"{world}/{level:g}/")]
            task = cast(Discrimination, done.experiments["fig8"][names[0]])
            for how, by in _HOW.items():
                limit = limits(task.distances, [done.results["fig8"][name] for name in names], how)
                for row, key in enumerate(task.methods):
                    theirs = paper.DISCRIMINATION[key.rstrip("+")]
                    here = f"{_mm(limit.overall[row])}; by area {', '.join(_mm(d) for d in limit.by_area[row])}"
                    note = f"Takes single contacts for two in {100 * limit.false[row]:.1f} % of trials."
                    text = f"{key} tells contacts {theirs * 1e3:.0f} mm apart from one by {by}, {level:g} dB"
                    verdict = YES if limit.overall[row] <= theirs else NO
                    key_claim = world == "pressed" and level == done.settings.fine_noise
                    found.append(Claim("fig8", world, text, f"{theirs * 1e3:.0f} mm", here, verdict, note, key_claim))
    return found


def _mm(distance: float) -> str:
    return f"{distance * 1e3:.0f} mm" if np.isfinite(distance) else "none up to 60 mm"
