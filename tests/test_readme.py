"""What README.md shows is so: its Python runs, its links lead somewhere, its commands exist."""

import re
from itertools import islice
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_loop_prints_the_contact_it_pressed(capsys: pytest.CaptureFixture[str]) -> None:
    endless = "engine.touches()"
    assert endless in SNIPPETS[0]
    exec(SNIPPETS[0].replace(endless, f"islice({endless}, 30)"), {"islice": islice})
    printed = re.findall(r"position=\(([\d.]+), ([\d.]+)\)", capsys.readouterr().out)
    assert printed
    x, y = map(float, printed[-1])
    assert abs(x - 0.05) < 0.003
    assert abs(y - 0.12) < 0.003


def test_the_mathematics_images_a_touch_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    exec(SNIPPETS[1], names)
    assert names["frame"].voltages.shape == (208,)  # type: ignore[attr-defined]
    x, y = map(float, capsys.readouterr().out.strip(" []\n").split())
    assert abs(x - 0.05) < 0.005
    assert abs(y - 0.12) < 0.005


def test_the_guide_has_the_same_and_it_takes_eight_lines() -> None:
    assert f"```python\n{SNIPPETS[1]}```" in (ROOT / "docs" / "guide" / "coming-from.md").read_text(encoding="utf-8")
    steps = [line for line in SNIPPETS[1].splitlines() if line and not line.startswith(("import", "print"))]
    assert len(steps) == 8


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def anchors(page: Path) -> set[str]:
    """What links to the headings of a page end with."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


def test_every_link_leads_somewhere() -> None:
    """Links to what `make docs` makes are checked when it makes it."""
    made = tuple(line for line in (ROOT / ".gitignore").read_text().splitlines() if line.startswith("/docs/"))
    folders = ("docs", "examples", "firmware", "integrations", "ros")
    pages = [ROOT / "README.md", *(page for folder in folders for page in (ROOT / folder).rglob("*.md"))]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)\s:]+)\)", prose(page))]
    assert sum("#" in link for _, link in links) > 20
    for page, link in links:
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not f"/{target.relative_to(ROOT)}".startswith(made):
            assert target.exists(), f"{page.name} links to {link}"
            assert not anchor or anchor in anchors(target), f"{page.name} links to {link}, which is no heading there"


def test_every_command_exists() -> None:
    from ohmskin.cli import app

    commands = re.findall(r"^\.venv/bin/ohmskin ([\w-]+)", README, re.MULTILINE)
    assert len(commands) >= 6
    for command in commands:
        assert command in app
    targets = re.findall(r"^make (\w+)", README, re.MULTILINE)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert targets == ["live", "test", "docs"]
    assert all(f"\n{target}:" in makefile for target in targets)
