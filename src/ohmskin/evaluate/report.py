"""The report: one HTML file that needs nothing else."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path

import numpy as np

import ohmskin
from ohmskin.evaluate import paper
from ohmskin.evaluate.experiments.localisation import errors
from ohmskin.evaluate.experiments.merits import COLUMNS, EIDORS_COLUMNS
from ohmskin.evaluate.figures import Picture
from ohmskin.evaluate.figures.style import WORLD_NAMES
from ohmskin.evaluate.methods import BEST, METHODS, all_methods
from ohmskin.evaluate.reproduction import Reproduction
from ohmskin.evaluate.statistics import median
from ohmskin.evaluate.verdict import NO, OPEN, YES, Claim
from ohmskin.evaluate.worlds import CONTACT_RADIUS, CONTACT_STRENGTH, CURRENT, full_scale, noise_volts

TITLES = {
    "fig3": ("Fig. 3", "Single touches"),
    "fig4": ("Fig. 4", "Several touches"),
    "fig5": ("Fig. 5", "Cross-sections"),
    "table1": ("Table I", "Figures of merit of one touch"),
    "fig6": ("Fig. 6", "Contact shapes"),
    "fig7": ("Fig. 7", "Localisation at 81 places"),
    "fig8": ("Fig. 8", "Two-point discrimination"),
    "sweep": ("Sweep", "What depends on noise and prior amplitude"),
}
_CLASS = {YES: "yes", OPEN: "open", NO: "no"}
_MISS = 30e-3  # metres; a touch seen further away counts as missed


def write_report(done: Reproduction, claims: Sequence[Claim], pictures: dict[str, list[Picture]], path: Path) -> Path:
    """Write the report; returns its path."""
    page = (resources.files("ohmskin.evaluate") / "page.html").read_text(encoding="utf-8")
    sections = "\n".join(_section(done, figure, claims, pictures.get(figure, [])) for figure in done.results)
    for name, text in (("version", ohmskin.__version__), ("head", _head(done, claims)), ("sections", sections)):
        page = page.replace("{{" + name + "}}", text)
    path.write_text(page, encoding="utf-8")
    return path


def _head(done: Reproduction, claims: Sequence[Claim]) -> str:
    links = " ".join(f"<a href='#{figure}'>{TITLES[figure][0]}</a>" for figure in done.results)
    key = [claim for claim in claims if claim.key]
    summary = f"<h2>In short</h2>{_claims(key)}" if key else ""
    tally = _table(
        ("", *_CLASS),
        [
            (TITLES[f][0], *(str(sum(c.verdict == v and c.figure == f for c in claims)) for v in _CLASS))
            for f in done.results
            if any(c.figure == f for c in claims)
        ],
    )
    settings = done.settings
    levels = [f"{1e6 * noise_volts(world, settings.noise[0]):.0f}" for world in WORLD_NAMES]
    data = [
        (
            WORLD_NAMES[world],
            f"{1e3 * CONTACT_RADIUS[world]:g} mm",
            f"+{100 * CONTACT_STRENGTH[world]:g} %" if world == "discs" else f"{CONTACT_STRENGTH[world] / 1e3:g} kPa",
            f"{1e3 * full_scale(world):.1f} mV",
            f"{level} µV",
        )
        for world, level in zip(WORLD_NAMES, levels, strict=True)
    ]
    methods = [
        (m.key, m.label, m.title, str(m.injections), "best mode that ohmskin has" if key == BEST else "")
        for key, m in all_methods().items()
    ]
    return (
        f"<nav>{links}</nav>{summary}<h2>How it was done</h2>"
        "<p>Data come from two models of a touched sheet, both on meshes unlike the estimator's, with white noise of one "
        f"standard deviation for all methods and {1e3 * CURRENT:g} mA in every injection. All images are one-step "
        "Gauss-Newton with the paper's prior, eq. (5), and one rule for its weight: λ = <i>noise</i>² mean(diag R⁻¹) / s², "
        f"with the noise in volts and s the prior amplitude ({settings.amplitude[0]:g} unless a figure says otherwise). "
        f"{settings.seeds} noise seeds, {10 * settings.seeds} for Fig. 5 and Table I. Where the paper gives no position, "
        "size, noise or regularisation, they were chosen beforehand and are stated.</p>"
        + _table(("data", "radius", "strength", "largest 12B voltage", f"noise at {settings.noise[0]:g} dB"), data)
        + _table(("key", "label", "what is driven and imaged", "injections", ""), methods)
        + f"<details><summary>How many claims of each figure come out</summary>{tally}</details>"
    )


def _section(done: Reproduction, figure: str, claims: Sequence[Claim], pictures: Sequence[Picture]) -> str:
    label, title = TITLES[figure]
    own = paper.TESTED_ON.get(figure, "")
    other = WORLD_NAMES["pressed" if own == "discs" else "discs"]
    mine = [c for c in claims if c.figure == figure]
    apart = len(pictures) > 1 and figure in ("fig3", "fig4")  # one picture per world
    first, more = (list(pictures[:1]), list(pictures[1:])) if apart else (list(pictures), [])
    tables = {"table1": _table1, "fig7": _fig7}.get(figure, lambda _, __: "")
    aside = _pictures(label, more) + _claims([c for c in mine if c.world != own])
    if figure == "table1":
        aside = tables(done, "pressed") + aside
    rest = f"<details><summary>The same on the {other}</summary>{aside}</details>" if aside else ""
    return (
        f"<section id='{figure}'><h2><span>{label}</span> {title}</h2><blockquote><b>The paper:</b> "
        f"{escape(paper.SAYS[figure])}</blockquote>"
        f"{_pictures(label, first)}{tables(done, own)}{_claims([c for c in mine if c.world == own])}{rest}</section>"
    )


def _pictures(label: str, pictures: Iterable[Picture]) -> str:
    return "".join(
        f"<figure><img alt='{escape(p.caption, quote=True)}' src='data:image/png;base64,"
        f"{base64.b64encode(p.path.read_bytes()).decode()}'><figcaption><b>{label}.</b> "
        f"{escape(p.caption)}</figcaption></figure>"
        for p in pictures
    )


def _claims(claims: Sequence[Claim]) -> str:
    if not claims:
        return ""
    rows = "".join(
        f"<tr><td><span class='chip {_CLASS[c.verdict]}'>{c.verdict}</span></td>"
        f"<td>{escape(c.claim)}<br><small>{TITLES[c.figure][0]}, {WORLD_NAMES[c.world]}</small></td>"
        f"<td>{escape(c.paper)}</td>"
        f"<td>{escape(c.here)}{f'<br><small>{escape(c.note)}</small>' if c.note else ''}</td></tr>"
        for c in claims
    )
    head = "<tr><th>verdict</th><th>claim</th><th>paper</th><th>here</th></tr>"
    return f"<div class='wide'><table class='claims'><thead>{head}</thead><tbody>{rows}</tbody></table></div>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<div class='wide'><table class='numbers'><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"


def _cell(text: str) -> str:
    """A cell; the interval of a number goes below it."""
    value, bracket, interval = text.partition(" (")
    if bracket and value[-1:].isdigit():
        return f"{escape(value)}<br><small>{escape(interval.rstrip(')'))}</small>"
    return escape(text)


def _table1(done: Reproduction, world: str) -> str:
    result, labels = done.results["table1"][world], [all_methods()[key].label for key in METHODS]
    lengths = ("PE", "localisation")
    head = [f"{name} / mm" if name in lengths else name for name in COLUMNS]
    modern = [
        (label, *(median(result["modern"][m, :, k]).text(1e3 if n in lengths else 1) for k, n in enumerate(COLUMNS)))
        for m, label in enumerate(labels)
    ]
    eidors = []
    for m, key in enumerate(METHODS):
        theirs = paper.TABLE.get(key.rstrip("+"))
        cells = [labels[m]]
        for k in range(len(EIDORS_COLUMNS)):
            cells += [median(result["eidors"][m, :, k]).text(), f"{theirs[k]:g}" if theirs else ""]
        eidors.append(cells)
    both = [cell for name in paper.TABLE_COLUMNS for cell in (name, f"{name}, paper")]
    return (
        f"<h3>Modern definition, {WORLD_NAMES[world]}</h3>{_table(('method', *head), modern)}"
        f"<h3>As EIDORS computes them, beside the paper's table, "
        f"{WORLD_NAMES[world]}</h3>{_table(('method', *both), eidors)}"
        "<p><small>AR as EIDORS computes it is a sum over pixels and depends on the image's unit and size; only its "
        "order can be "
        "compared.</small></p>"
    )


def _fig7(done: Reproduction, _: str) -> str:
    rows = []
    for world, result in done.results["fig7"].items():
        for m, key in enumerate(METHODS):
            error = errors(result)[m]
            theirs = paper.LOCALISATION.get(key.rstrip("+"))
            rows.append(
                (
                    f"{WORLD_NAMES[world]}, {float(result['decibels']):g} dB",
                    all_methods()[key].label,
                    f"{1e3 * error.mean():.2f}",
                    f"{1e3 * np.median(error):.2f}",
                    f"{1e3 * np.quantile(error, 0.95):.1f}",
                    f"{100 * np.mean(error > _MISS):.1f} %",
                    f"{theirs * 1e3:.2f}" if theirs else "",
                )
            )
    head = (
        "data",
        "method",
        "mean / mm",
        "median / mm",
        "95th percentile / mm",
        f"off by over {1e3 * _MISS:.0f} mm",
        "paper, mean / mm",
    )
    return _table(head, rows)
