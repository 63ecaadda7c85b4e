"""Reports in HTML and in Markdown say the same, and all pictures take their colours from the live page."""

import ast
import base64
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from playwright.sync_api import Browser

from ohmskin.bench import Figure
from ohmskin.bench.report import write_report
from ohmskin.evaluate.figures.drawing import RC, panels
from ohmskin.plot import colours
from ohmskin.plot.report import Section, Table
from ohmskin.plot.report import write_report as write_page

SCRIPT = Path(colours.__file__).parents[1] / "view" / "static" / "colour.js"


def test_the_benchmark_is_written_as_a_page_and_as_markdown(tmp_path: Path) -> None:
    figure = Figure("time & space", 2.0, "s", most=1.0, low=1.5, high=2.5)
    write_report({"machine": [figure]}, tmp_path, quick=True)
    page = (tmp_path / "benchmarks.html").read_text(encoding="utf-8")
    text = (tmp_path / "benchmarks.md").read_text(encoding="utf-8")
    assert "<h1>Benchmarks</h1>" in page
    assert "<td>time &amp; space</td>" in page
    assert "chip no'>short" in page
    assert "| time & space | 2 s | 1.5 to 2.5 | at most 1 | **short** |" in text
    assert "0 targets met, 1 short, 0 not run; --quick" in page
    (icon,) = re.findall(r'rel="icon" href="data:image/svg\+xml;base64,(.*?)"', page)  # a browser asks for no other
    assert base64.b64decode(icon) == (SCRIPT.parent / "icon.svg").read_bytes()
    assert "0 targets met, 1 short, 0 not run; --quick" in text


def test_sentences_in_tables_take_several_lines_and_leave_room_for_verdicts(tmp_path: Path, chromium: Browser) -> None:
    goal, note = (
        "Error of 16P over that of the best set of 28 (discs, 40 dB, driven electrodes measured), " * 2,
        "n " * 70,
    )
    rows = [(goal, "≤ 1.00", "0.81 (0.69 to 0.96)", "met", note)]
    table = Table(("goal", "asked", "measured (95 %)", "verdict", "note"), rows)
    path = write_page([Section("Goals of `16P` & best", [table], "#")], tmp_path / "report.html")
    page = chromium.new_page(viewport={"width": 1024, "height": 700})
    page.goto(path.as_uri())
    assert page.locator("h1 code").inner_text() == "16P"
    wide, box = page.locator(".wide"), page.locator(".chip").bounding_box()
    assert box is not None
    assert box["x"] + box["width"] < 1024
    assert wide.evaluate("(it) => it.scrollWidth <= it.clientWidth")
    assert "best set of 28 (discs" in page.locator("td").first.inner_text()
    page.close()


@pytest.mark.parametrize(
    ("theme", "sign", "stops"),
    [
        ("light", "positive", colours.POSITIVE),
        ("light", "negative", colours.NEGATIVE),
        ("dark", "positive", colours.DARK),
    ],
)
def test_colours_are_those_of_the_page(theme: str, sign: str, stops: colours.Stops) -> None:
    script = SCRIPT.read_text(encoding="utf-8")
    (block,) = re.findall(rf"{sign}: \[(.*?)\n    \]", script[script.index(f"  {theme}: {{") :], re.DOTALL)[:1]
    assert re.findall(r"\[(\S+), (\S+), (\S+)\]", block) == [tuple(f"{v:g}" for v in stop) for stop in stops]


MAPPED = {"imshow", "pcolor", "pcolormesh", "tripcolor", "contourf", "tricontourf", "matshow", "hexbin"}


def test_every_picture_takes_one_family_of_colours() -> None:
    """Calls that turn numbers into colours name a map of `ohmskin.plot.colours`, or get it with a style."""
    root, strange, seen = Path(__file__).parents[1], list[str](), 0
    scripts = [path for folder in ("src", "examples", "docs", "benchmarks") for path in (root / folder).rglob("*.py")]
    for path in scripts:
        if {"_build", "gallery"} & {*path.relative_to(root).parts}:
            continue
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "attr", "") in MAPPED:
                given = {keyword.arg: keyword.value for keyword in call.keywords}
                plain = not {"cmap", None} & {*given} or isinstance(given.get("cmap"), ast.Constant)
                seen += 1
                strange += [f"{path.name}:{call.lineno}"] * plain
    assert strange == []
    assert seen > 15


def test_more_is_always_darker_and_on_dark_ground_brighter() -> None:
    weights = np.array([0.2126, 0.7152, 0.0722])  # luminance of linear sRGB
    for shades, way in ((colours.AMOUNT, -1), (colours.GLOWING, 1)):
        light = shades(np.linspace(0, 1, 256))[:, :3] ** 2.2 @ weights
        assert (way * np.diff(light) > -1e-3).all()
        assert way * (light[-1] - light[0]) > 0.5


def test_labels_lie_within_pictures() -> None:
    """Those of narrow panels, too, as at the right of Fig. 5."""
    with matplotlib.rc_context(RC):
        canvas, ((wide, _, narrow),) = panels(2.3, 1, 3, width_ratios=[2.1, 1, 1])
        wide.set(xlabel="x / mm", ylabel="relative change of conductivity")
        narrow.set(xlabel="width / mm", xlim=(0, 30))
        FigureCanvasAgg(canvas).draw()
    for axes in canvas.axes:
        for label in (axes.xaxis.label, axes.yaxis.label):
            (x0, y0), (x1, y1) = label.get_window_extent().get_points()
            assert x0 >= 0 <= y0
            assert x1 <= canvas.bbox.width
            assert y1 <= canvas.bbox.height
