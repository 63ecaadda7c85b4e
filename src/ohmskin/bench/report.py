"""What a run of the benchmark leaves behind: JSON, its tables in HTML and Markdown, a plot of cost against size."""

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import numba
import numpy as np
import scipy

from ohmskin.bench.figure import Figure
from ohmskin.bench.run import GROUPS
from ohmskin.errors import OhmskinError
from ohmskin.plot.report import ReportImage, ReportPicture, Section, Table, write_whole
from ohmskin.plot.report import write_report as write_sections

_PREFACE = (
    "Made by `ohmskin bench`; run it for these figures of your own machine (`--quick`: smaller sizes, fewer rounds).",
    "Everything is measured in one run, in turns, on one thread, in CPU time unless a wall clock is named. A "
    "value is the median over the rounds, the spread its quartiles. Unless a figure names another, and but for "
    "the live loop, which has the paper's skin as it ships, the sheet is the paper's square with 12 electrodes on "
    "the rim and 4 inside, its mesh regular, and the same for all programs. pyEIT is used as its own examples use "
    "it. Compiled code is loaded before the clock starts: the very first run on a machine compiles it, which "
    "takes half a minute. Set-up means from nodes and triangles to the first image; making the mesh is not part "
    "of it.",
)


_TALLY = {"pass": "targets met", "short": "short", "not run": "not run"}


def write_report(
    found: Mapping[str, Sequence[Figure]],
    folder: Path,
    quick: bool,
    missing: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write benchmarks.json, benchmarks.html, benchmarks.md and, where sizes were measured, images/scale.png.

    Each file is there as it was or as it is now, never in part, so that a run may write what it has at any time.

    Args:
        found: Figures by group.
        folder: Where to.
        quick: Whether sizes were small and rounds few.
        missing: Groups that are still to be measured.
        seconds: How long groups took (s).

    Raises:
        OhmskinError: If the folder cannot be written.
    """
    try:
        (folder / "images").mkdir(parents=True, exist_ok=True)
        written = [folder / "benchmarks.json"]
        groups = {name: [figure.as_dict() for figure in figures] for name, figures in found.items()}
        run = {"machine": _machine(), "quick": quick, "missing": list(missing), "seconds": dict(seconds or {})}
        write_whole(written[0], json.dumps({**run, "groups": groups}, indent=1) + "\n")
        grown = [figure for figure in found.get("scale", ()) if figure.data]
        plots = [_plot(figure, folder / "images" / "scale.png") for figure in grown[:1]]
        sections = _sections(found, quick, missing, plots)
        written += [write_sections(sections, folder / f"benchmarks.{kind}") for kind in ("html", "md")] + plots
    except OSError as error:
        raise OhmskinError(f"cannot write the report to {folder}: {error}; choose another with --output") from error
    return written


def last_seconds(folder: Path, quick: bool) -> dict[str, float]:
    """How long each group took (s) in the run whose report is in a `folder`, if that was as `quick`; else nothing."""
    try:
        run = json.loads((folder / "benchmarks.json").read_text(encoding="utf-8"))
        return {name: float(value) for name, value in run["seconds"].items()} if run["quick"] == quick else {}
    except (OSError, ValueError, TypeError, LookupError, AttributeError):  # none yet, of an earlier version, or edited
        return {}


def _machine() -> dict[str, str]:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    numerics = f"NumPy {np.__version__}, SciPy {scipy.__version__}, numba {numba.__version__}"
    return {
        "processor": next(named, platform.processor() or "unknown"),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": f"Python {platform.python_version()}, {numerics}",
    }


def _sections(
    found: Mapping[str, Sequence[Figure]], quick: bool, missing: Sequence[str], plots: Sequence[Path]
) -> list[Section]:
    told = _machine()
    machine = f"Machine: {told['processor']}, {told['cores']} cores, {told['system']}; {told['versions']}."
    verdicts = [figure.verdict for group in found.values() for figure in group]
    counted = ", ".join(f"{verdicts.count(name)} {words}" for name, words in _TALLY.items())
    counted += f"{'; --quick' if quick else ''}{'; not measured yet: ' if missing else ''}{', '.join(missing)}."
    sections = [Section("Benchmarks", [*_PREFACE, machine, counted], "#")]
    for name, group in found.items():
        title = (GROUPS[name].__doc__ or name).splitlines()[0].rstrip(".")
        head = ("figure", "value", "spread", "target", "", "from")
        sections.append(Section(title, [Table(head, [figure.row(figure.verdict) for figure in group])]))
    caption = "CPU seconds of the set-up against the number of triangles"
    pictures = [ReportImage(caption, ReportPicture(plot.stem, plot, f"{caption}, one thread.")) for plot in plots]
    return [*sections, *([Section("Cost against size", pictures)] if pictures else [])]


def _plot(figure: Figure, path: Path) -> Path:
    from matplotlib.figure import Figure as Canvas

    n, seconds = np.array(figure.data["triangles"], float), np.array(figure.data["seconds"])
    large = n >= 10_000
    power, offset = np.polyfit(np.log(n[large]), np.log(seconds[large]), 1)
    canvas = Canvas(figsize=(6.4, 4.0), layout="constrained")
    axes = canvas.subplots()
    axes.loglog(n, seconds, "o-", color="#1f5f8b", label="set-up to first image")
    colours = {"check mesh": "#b8b8b8", "fields": "#d08a2e", "pixels": "#6a994e", "modes": "#8a5fa8"}
    for stage, colour in colours.items():
        axes.loglog(n, [s[stage] for s in figure.data["stages"]], ".--", lw=1, color=colour, label=stage)
    fit = np.exp(offset) * n[large] ** power
    axes.loglog(n[large], fit, color="black", lw=1, label=f"fit from 10,000: n^{power:.2f}")
    axes.set(xlabel="triangles", ylabel="CPU seconds, one thread")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
    canvas.savefig(path, dpi=130)
    return path
