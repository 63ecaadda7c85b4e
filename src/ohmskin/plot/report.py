"""Reports: sections of texts, tables and pictures, written as one HTML file that needs nothing else, or as Markdown."""

import base64
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path

import ohmskin

_CLASS = {
    **dict.fromkeys(("confirmed", "met", "pass"), "yes"),
    **dict.fromkeys(("undecided", "not run"), "open"),
    **dict.fromkeys(("not confirmed", "missed", "short"), "no"),
}
_PROSE = 40  # characters from which on a cell is a sentence, which may take several lines


@dataclass(frozen=True)
class ReportPicture:
    """A picture and the caption that makes it stand alone."""

    name: str
    path: Path
    caption: str


@dataclass(frozen=True)
class Table:
    """A table of texts. A second line of a cell is set small; so is, if `numbers`, the interval of a number."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: bool = True


@dataclass(frozen=True)
class ReportImage:
    """A picture with its caption; `label` stands before the caption, or for the picture where that cannot be seen."""

    label: str
    picture: ReportPicture


@dataclass(frozen=True)
class Folded:
    """What is shown when its `summary` is clicked (HTML only)."""

    summary: str
    blocks: Sequence["Block"]


# a text is a paragraph of Markdown: *emphasis*, **strong**, `code`, > quotation, ### heading
Block = str | Table | ReportImage | Folded


@dataclass(frozen=True)
class Section:
    """A part of a report.

    Args:
        title: Its heading.
        blocks: What it shows.
        label: Stands before the title; ``#``: the section opens the report, and its title is the report's.
        anchor: Its address within the page (HTML).
    """

    title: str
    blocks: Sequence[Block] = field(repr=False)
    label: str = ""
    anchor: str = ""


def write_report(sections: Sequence[Section], path: Path) -> Path:
    """Write a report, in HTML if the file is called so, otherwise in Markdown; returns its path."""
    if path.suffix == ".html":
        page = (resources.files("ohmskin.plot") / "page.html").read_text(encoding="utf-8")
        links = " ".join(f"<a href='#{s.anchor}'>{s.label}</a>" for s in sections if s.anchor)
        parts = [_html_section(section) for section in sections]
        body = "\n".join([parts[0], f"<nav>{links}</nav>", *parts[1:]])
        icon = base64.b64encode((resources.files("ohmskin") / "view" / "static" / "icon.svg").read_bytes()).decode()
        said = {
            "title": escape(sections[0].title.replace("`", "")),
            "version": ohmskin.__version__,
            "icon": icon,
            "body": body,
        }
        for name, text in said.items():
            page = page.replace("{{" + name + "}}", text)
    else:
        page = "\n\n".join(part for section in sections for part in _markdown_section(section, path.parent)) + "\n"
    write_whole(path, page)
    return path


def write_whole(path: Path, text: str) -> None:
    """Put a `text` into a file (`path`): whoever looks finds all of it, or what was there before."""
    part = path.with_name(f"{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def _html_section(section: Section) -> str:
    if section.label == "#":
        return f"<h1>{_inline(section.title)}</h1>{''.join(map(_html, section.blocks))}"
    title = f"<span>{section.label}</span> {_inline(section.title)}" if section.label else _inline(section.title)
    anchor = f" id='{section.anchor}'" if section.anchor else ""
    return f"<section{anchor}><h2>{title}</h2>{''.join(map(_html, section.blocks))}</section>"


def _html(block: Block) -> str:
    if isinstance(block, Table):
        kind = "numbers" if block.numbers else "claims"
        head = "".join(f"<th>{escape(text)}</th>" if text else "<td></td>" for text in block.head)
        rows = "".join(f"<tr>{''.join(_cell(text, block.numbers) for text in row)}</tr>" for row in block.rows)
        table = f"<table class='{kind}'><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        label = escape(f"Table: {', '.join(filter(None, block.head))}", quote=True)
        return f"<div class='wide' tabindex='0' role='group' aria-label='{label}'>{table}</div>"  # keys scroll it
    if isinstance(block, ReportImage):
        data, caption = base64.b64encode(block.picture.path.read_bytes()).decode(), escape(block.picture.caption)
        image = f"<img alt='{escape(block.picture.caption, quote=True)}' src='data:image/png;base64,{data}'>"
        return f"<figure>{image}<figcaption><b>{block.label}.</b> {caption}</figcaption></figure>"
    if isinstance(block, Folded):
        return f"<details><summary>{block.summary}</summary>{''.join(map(_html, block.blocks))}</details>"
    text = _inline(block)
    if text.startswith("### "):
        return f"<h3>{text[4:]}</h3>"
    return f"<blockquote>{text[5:]}</blockquote>" if text.startswith("&gt; ") else f"<p>{text}</p>"


def _inline(text: str) -> str:
    text = escape(text, quote=False)
    for mark, tag in ((r"`(.+?)`", "code"), (r"\*\*(.+?)\*\*", "b"), (r"\*(.+?)\*", "i")):
        text = re.sub(mark, rf"<{tag}>\1</{tag}>", text)
    return text


def _cell(text: str, numbers: bool) -> str:
    if len(text) > _PROSE:
        return f"<td class='prose'>{_lines(text)}</td>"
    return f"<td>{_number(text) if numbers else _lines(text)}</td>"


def _number(text: str) -> str:
    value, bracket, interval = text.partition(" (")
    if bracket and value[-1:].isdigit():
        return f"{escape(value)}<br><small>{escape(interval.rstrip(')'))}</small>"
    return _lines(text)


def _lines(text: str) -> str:
    if text in _CLASS:
        return f"<span class='chip {_CLASS[text]}'>{text}</span>"
    first, _, second = text.partition("\n")
    return escape(first) + (f"<br><small>{escape(second)}</small>" if second else "")


def _markdown_section(section: Section, folder: Path) -> Iterable[str]:
    yield f"# {section.title}" if section.label == "#" else f"## {section.title}"
    for block in section.blocks:
        if isinstance(block, Table):
            lines = [block.head, ["---"] * len(block.head), *block.rows]
            yield "\n".join("| " + " | ".join(map(_markdown_cell, line)) + " |" for line in lines)
        elif isinstance(block, ReportImage):
            yield f"![{block.label}]({os.path.relpath(block.picture.path, folder)})\n\n*{block.picture.caption}*"
        elif isinstance(block, Folded):
            raise TypeError("Markdown has no folded blocks; give the blocks themselves")
        elif block:
            yield block


def _markdown_cell(text: str) -> str:
    return f"**{text}**" if text in _CLASS else text.replace("|", "\\|").replace("\n", "<br>")
