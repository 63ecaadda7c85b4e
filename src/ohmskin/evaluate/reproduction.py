"""The paper's experiments, sections V-A and V-B, as a study, and its report."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

import ohmskin
from ohmskin.evaluate import paper
from ohmskin.evaluate.assumed import Assumed, assumed
from ohmskin.evaluate.claims import assess
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.experiments.touches import COLUMNS, EIDORS_COLUMNS
from ohmskin.evaluate.figures import curves, images
from ohmskin.evaluate.figures.assumptions import assumptions
from ohmskin.evaluate.methods import METHODS, all_methods
from ohmskin.evaluate.plan import Settings, plan
from ohmskin.evaluate.result import Outcome
from ohmskin.evaluate.statistics import median
from ohmskin.evaluate.study import Study
from ohmskin.evaluate.verdict import NO, OPEN, YES, Claim
from ohmskin.evaluate.worlds import CURRENT, WORLD_NAMES, described
from ohmskin.plot.report import Block, Folded, ReportImage, ReportPicture, Section, Table

SHOWN = {
    "fig3": ("Fig. 3", "Single touches", images.single),
    "fig4": ("Fig. 4", "Several touches", images.several),
    "fig5": ("Fig. 5", "Cross-sections", curves.sections),
    "table1": ("Table I", "Figures of merit of one touch", curves.merits),
    "fig6": ("Fig. 6", "Contact shapes", images.shapes),
    "fig7": ("Fig. 7", "Localisation at 81 places", curves.localisation),
    "fig8": ("Fig. 8", "Two-point discrimination", curves.discrimination),
    "sweep": ("Sweep", "What depends on noise and prior amplitude", curves.sweep),
    "assumptions": ("Assumptions", "Which single assumption would confirm the paper's figures", assumptions),
}
_VERDICTS = (YES, OPEN, NO)  # best first
MISS = 30e-3  # metres; a touch seen further away counts as missed
INTRODUCTION = (
    "Zheng, Liu, Guo, Yang: *Adaptive Optimal Electrical Resistance Tomography for Large-Area Tactile "
    f"Sensing*, sections V-A and V-B, run again with ohmskin {ohmskin.__version__}. Every verdict is computed "
    f"from the data behind the pictures. A claim is **{YES}** if the medians over noise seeds say so and at "
    f"least 95 % of bootstrap resamples of the seeds agree; it is **{OPEN}** if fewer agree, and **{NO}** if "
    "the medians say otherwise. Intervals in brackets are 95 % bootstrap intervals."
)
Done = Outcome[Settings]


def sections(done: Done, claims: Sequence[Claim], pictures: Mapping[str, Sequence[ReportPicture]]) -> list[Section]:
    """The report: what it comes to, how it was done, and a section for each figure."""
    opening = Section("The paper, reproduced", [INTRODUCTION], "#")
    short = [Section("In short", _short(done, claims))] if claims else []
    figures = [_figure(done, figure, claims, pictures[figure]) for figure in done.results]
    return [opening, *short, Section("How it was done", _method(done)), *figures]


def _short(done: Done, claims: Sequence[Claim]) -> list[Block]:
    """What it comes to in three sentences, how many claims of each figure have each verdict, and the key claims."""
    found = {SHOWN[name][0]: [c.verdict for c in claims if c.figure == name] for name in done.results}
    counts = {label: [mine.count(verdict) for verdict in _VERDICTS] for label, mine in found.items() if mine}
    yes, undecided, no = (sum(each) for each in zip(*counts.values(), strict=True))
    shares = {label: each[0] / sum(each) for label, each in counts.items()}
    best, worst = max(shares, key=shares.__getitem__), min(shares, key=shares.__getitem__)
    key = sorted((claim for claim in claims if claim.key), key=lambda claim: _VERDICTS.index(claim.verdict))
    text = (
        f"**{yes} of {len(claims)} tested claims of the paper are {YES}, {undecided} are {OPEN} and {no} are {NO}.** "
        f"Of the {len(key)} most important ones, below, {sum(claim.verdict == YES for claim in key)} are {YES}. "
        f"The largest share is {YES} for {best} ({100 * shares[best]:.0f} %), "
        f"the smallest for {worst} ({100 * shares[worst]:.0f} %)."
    )
    return [text, Table(("claims of", *_VERDICTS), [(n, *map(str, each)) for n, each in counts.items()]), *_claims(key)]


def _method(done: Done) -> list[Block]:
    settings = done.settings
    notes = {METHODS[-1]: "the paper's, all data used"}
    methods = [(m.key, m.label, m.title, str(m.injections), notes.get(m.key, "")) for m in all_methods().values()]
    text = (
        "Data come from two models of a touched sheet, both on meshes unlike the estimator's, with white noise of one "
        f"standard deviation for all methods and {1e3 * CURRENT:g} mA in every injection. All images are one-step "
        "Gauss-Newton with the paper's prior, eq. (5), and one rule for its weight: λ = *noise*² mean(diag R⁻¹) / s², "
        f"with the noise in volts and s the prior amplitude ({settings.amplitude[0]:g} unless a figure says "
        f"otherwise). {settings.seeds} noise seeds, {10 * settings.seeds} for Fig. 5 and Table I. Where the paper "
        "gives no position, size, noise or regularisation, they were chosen beforehand and are stated."
    )
    return [
        text,
        Table(("data", "contact", "largest 12B voltage", "noise"), described(settings.noise[:1])),
        Table(("key", "label", "what is driven and imaged", "injections", ""), methods),
    ]


def _figure(done: Done, figure: str, claims: Sequence[Claim], pictures: Sequence[ReportPicture]) -> Section:
    label, title, _ = SHOWN[figure]
    own = paper.TESTED_ON.get(figure, "")
    other = "pressed" if own == "discs" else "discs"
    mine = [c for c in claims if c.figure == figure]
    shown: list[Block] = [ReportImage(label, picture) for picture in pictures]
    apart = 1 if figure in ("fig3", "fig4") else len(shown)  # there, one picture per world
    tables = {"table1": _merits, "fig7": _errors, "assumptions": _assumptions}
    aside = _merits(done, other) if figure == "table1" else []
    aside = [*aside, *shown[apart:], *_claims([c for c in mine if c.world != own])]
    blocks = [f"> **The paper:** {paper.SAYS[figure]}", *shown[:apart]]
    blocks += tables[figure](done, own) if figure in tables else []
    blocks += _claims([c for c in mine if c.world == own])
    blocks += [Folded(f"The same on the {WORLD_NAMES[other]}", aside)] if aside else []
    return Section(title, blocks, label, figure)


def _claims(claims: Sequence[Claim]) -> list[Block]:
    rows = [
        (c.verdict, f"{c.claim}\n{SHOWN[c.figure][0]}, {WORLD_NAMES[c.world]}", c.paper, f"{c.here}\n{c.note}")
        for c in claims
    ]
    return [Table(("verdict", "claim", "paper", "here"), rows, numbers=False)] if rows else []


def _merits(done: Done, world: str) -> list[Block]:
    result, lengths = done.results["table1"][world], ("PE", "localisation")
    modern, eidors, scales = [], [], [1e3 if name in lengths else 1 for name in COLUMNS]
    for m, (key, method) in enumerate(all_methods().items()):
        values = zip(result["modern"][m].T, scales, strict=True)
        modern.append((method.label, *(median(column).text(scale) for column, scale in values)))
        theirs = paper.TABLE.get(key.removesuffix(" fused"))
        published = [f"{value:g}" for value in theirs] if theirs else [""] * len(EIDORS_COLUMNS)
        pairs = zip(result["eidors"][m].T, published, strict=True)
        eidors.append([method.label, *(cell for column, other in pairs for cell in (median(column).text(), other))])
    both = [cell for name in EIDORS_COLUMNS for cell in (name, f"{name}, paper")]
    return [
        f"### Modern definition, {WORLD_NAMES[world]}",
        Table(("method", *(f"{name} / mm" if name in lengths else name for name in COLUMNS)), modern),
        f"### As EIDORS computes them, beside the paper's table, {WORLD_NAMES[world]}",
        Table(("method", *both), eidors),
        "AR as EIDORS computes it is a sum over pixels and depends on the image's unit and size; only its order can be "
        "compared. RES and RNG are the paper's SR and R.",
    ]


def _errors(done: Done, _: str) -> list[Block]:
    rows = []
    for world, task, result in done.of("fig7"):
        for key, error in zip(task.methods, errors(result), strict=True):
            theirs = paper.LOCALISATION.get(key.removesuffix(" fused"))
            data = f"{WORLD_NAMES[world]}, {float(result['decibels']):g} dB"
            typical = f"{1e3 * error.mean():.2f}", f"{1e3 * np.median(error):.2f}"
            worst = f"{1e3 * np.quantile(error, 0.95):.1f}", f"{100 * np.mean(error > MISS):.1f} %"
            published = f"{theirs * 1e3:.2f}" if theirs else ""
            rows.append((data, all_methods()[key].label, *typical, *worst, published))
    head = ("data", "method", "mean / mm", "median / mm", "95th percentile / mm", f"off by over {1e3 * MISS:.0f} mm")
    return [Table((*head, "paper, mean / mm"), rows)]


def _assumptions(done: Done, _: str) -> list[Block]:
    """What each single assumption brings out, best first, and the answer in a sentence."""
    found = sorted(assumed(done), key=lambda one: -sum(verdict == YES for verdict in one.verdicts))
    full = list(dict.fromkeys(f"*{one.title}*" for one in found if one.verdicts == (YES,) * 3))
    names = "Table I", "Fig. 7", "Fig. 8"
    answers = ["**No single assumption confirms all three.**" if not full else f"**All three: {', '.join(full)}.**"]
    for number, name in enumerate(names):
        yes = Counter(one.title for one in found if one.verdicts[number] == YES)
        every = Counter(one.title for one in found)
        listed = "; ".join(f"{title} ({count} of {every[title]})" for title, count in yes.items())
        answers.append(f"{name}, of two drives in two worlds: {listed or 'none'}.")
    rows = [_row(one) for one in found]
    head = "assumption", *names, "steps of Table I", "noise / dB", "16I / mm", "adaptive / mm", "ratio", "apart / mm"
    return [" ".join(answers), Table(head, rows, numbers=False)]


def _row(one: Assumed) -> tuple[str, ...]:
    orders = ", ".join(f"{key} {count} of 3" for key, count in one.steps.items())
    apart = " and ".join(f"{1e3 * d:g}" if np.isfinite(d) else "none up to 60" for d in one.distances)
    means = one.adjacent.text(1e3), one.adaptive.text(1e3)
    where = f"{one.title}\n{one.best}, {WORLD_NAMES[one.world]}"
    return (where, *one.verdicts, orders, f"{one.decibels:g}", *means, one.ratio.text(), apart)


REPRODUCTION = Study(
    Settings, plan, assess, {name: paint for name, (*_, paint) in SHOWN.items()}, sections, ("report.html",), "claims"
)
reproduce = REPRODUCTION.run
