"""Draws the pictures of build-a-skin.md: electrode map, wiring, layers, and the template to cut patches by.

python docs/build_a_skin.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

import ohmskin as ohm


def electrode_map(skin: ohm.Skin, path: Path) -> None:
    """The shipped skin from above, seen through the foam, with its electrodes' numbers and its patches."""
    figure = Figure(figsize=(6.2, 6.0), layout="constrained")
    axes = figure.add_subplot()
    layer = skin.contact_layer
    width, height, patch = 1e3 * skin.sheet.width, 1e3 * skin.sheet.height, 1e3 * layer.patch
    axes.add_patch(Rectangle((0, 0), width, height, facecolor="0.93", edgecolor="0.2", linewidth=1.5))
    columns, rows = layer.counts(skin.domain)
    for x in (np.arange(columns) + 0.5) * width / columns:
        for y in (np.arange(rows) + 0.5) * height / rows:
            axes.add_patch(
                Rectangle((x - patch / 2, y - patch / 2), patch, patch, facecolor="#cfe0ee", edgecolor="none")
            )
    for number, (x, y) in enumerate(1e3 * skin.electrodes.positions):
        rim = number in skin.electrodes.rings[0]
        axes.plot(x, y, "o", markersize=19, color="#1b7837" if rim else "#762a83", clip_on=False, zorder=3)
        axes.text(x, y, str(number), color="white", ha="center", va="center", fontsize=10, zorder=4)
    axes.set(xlim=(-12, width + 12), ylim=(-12, height + 12), xlabel="x / mm", ylabel="y / mm", aspect="equal")
    axes.set_xticks(np.unique(np.round(1e3 * skin.electrodes.positions[:, 0], 1)))
    axes.set_yticks(np.unique(np.round(1e3 * skin.electrodes.positions[:, 1], 1)))
    axes.set_title("electrodes from above: rim 0-11 (green), inside 12-15 (violet)", fontsize=10)
    figure.savefig(path, dpi=110)


def box(axes: Axes, x: float, y: float, width: float, height: float, text: str, colour: str = "#e8eef4") -> None:
    axes.add_patch(FancyBboxPatch((x, y), width, height, boxstyle="round,pad=0.05", facecolor=colour, edgecolor="0.2"))
    axes.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=9)


def wire(
    axes: Axes, points: list[tuple[float, float]], text: str = "", at: tuple[float, float] = (0, 0), colour: str = "0.2"
) -> None:
    x, y = zip(*points, strict=True)
    axes.plot(x, y, color=colour, linewidth=1.4, zorder=0)
    if text:
        axes.text(*at, text, fontsize=8, color=colour, ha="center", va="center", backgroundcolor="white")


def wiring(path: Path) -> None:
    """Who is connected to whom."""
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    axes = figure.add_subplot()
    box(axes, 0.2, 2.6, 2.0, 1.6, "isolated supply\nor battery\n5 V, current limited")
    box(axes, 3.0, 4.4, 2.0, 1.2, "source multiplexer\nMAX306, 16 to 1")
    box(axes, 3.0, 0.6, 2.0, 1.2, "sink multiplexer\nMAX306, 16 to 1")
    box(axes, 6.2, 2.4, 1.8, 1.9, "skin\n16 electrodes", "#dfeedd")
    box(axes, 9.2, 3.4, 2.3, 1.6, "acquisition card\n16 inputs in parallel\n+ 1 for the shunt")
    box(axes, 9.2, 0.6, 2.3, 1.4, "microcontroller\nSTM32F107")
    box(axes, 12.4, 2.2, 1.7, 1.4, "host\nohmskin")
    red, blue, green = "#b2182b", "#2166ac", "#1b7837"
    wire(axes, [(1.2, 4.2), (1.2, 5.0), (3.0, 5.0)], "50 ohm in series", (2.0, 5.25), red)
    wire(axes, [(5.0, 5.0), (7.1, 5.0), (7.1, 4.3)], "16 wires", (6.1, 5.0), red)
    wire(axes, [(7.1, 2.4), (7.1, 1.2), (5.0, 1.2)], "16 wires", (6.2, 1.2), blue)
    wire(axes, [(3.0, 1.2), (1.2, 1.2), (1.2, 2.6)], "shunt 100 ohm", (2.0, 1.45), blue)
    wire(
        axes,
        [(1.8, 1.2), (1.8, 0.15), (8.7, 0.15), (8.7, 3.7), (9.2, 3.7)],
        "voltage over the shunt",
        (5.4, 0.15),
        "0.45",
    )
    wire(axes, [(8.0, 3.4), (8.45, 3.4), (8.45, 4.4), (9.2, 4.4)], "16 sense wires", (8.2, 4.75), "0.45")
    wire(axes, [(4.0, 4.4), (4.0, 1.8)], "", (0, 0), green)
    wire(axes, [(4.0, 2.1), (9.0, 2.1), (9.0, 1.6), (9.2, 1.6)], "4 address lines and enable each", (5.4, 2.1), green)
    wire(axes, [(11.5, 4.2), (13.2, 4.2), (13.2, 3.6)], "USB or bus", (12.4, 4.45))
    wire(axes, [(11.5, 1.3), (13.2, 1.3), (13.2, 2.2)], "UART, isolated", (12.4, 1.05))
    axes.set(xlim=(0, 14.4), ylim=(-0.2, 6))
    axes.set_axis_off()
    figure.savefig(path.with_suffix(".png"), dpi=110)
    figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})


def layers(path: Path) -> None:
    """A cut through the skin, not to scale."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.add_patch(Rectangle((0, 0), 10, 0.9, facecolor="#d9c9a3", edgecolor="0.3"))
    axes.add_patch(Rectangle((0, 0.9), 10, 0.16, facecolor="0.25"))
    for x in np.arange(0.4, 9.6, 1.04):
        axes.add_patch(Rectangle((x, 1.36), 0.82, 0.14, facecolor="#8fb3d1", edgecolor="0.3"))
    axes.add_patch(Rectangle((0, 1.5), 10, 1.0, facecolor="#c8c8c8", edgecolor="0.3"))
    for x in (0.35, 3.4, 6.5, 9.5):
        axes.add_patch(Rectangle((x, -0.4), 0.16, 1.46, facecolor="#b5651d"))
        axes.add_patch(Rectangle((x - 0.16, 1.06), 0.48, 0.08, facecolor="#b5651d"))
    labels = (
        (2.0, "foam (neoprene)"),
        (1.43, "patches 7.5 mm, 8.33 mm apart"),
        (0.98, "sprayed sheet 200 x 200 mm"),
        (0.45, "board"),
    )
    for y, text in labels:
        axes.annotate(text, (10, y), (10.4, y), fontsize=9, va="center", arrowprops={"arrowstyle": "-", "color": "0.4"})
    axes.annotate(
        "screw, the electrode", (9.58, -0.35), (10.4, -0.3), fontsize=9, va="center", arrowprops={"arrowstyle": "-"}
    )
    axes.set(xlim=(-0.1, 14.4), ylim=(-0.6, 2.7))
    axes.set_axis_off()
    figure.savefig(path, dpi=110)


def patches(skin: ohm.Skin, path: Path) -> None:
    """The template to cut the patches by, 1:1: closed paths in millimetres, and a bar to measure."""
    layer = skin.contact_layer
    columns, rows = layer.counts(skin.domain)
    width, height, side = 1e3 * skin.sheet.width, 1e3 * skin.sheet.height, 1e3 * layer.patch
    corners = [
        ((column + 0.5) * width / columns - side / 2, (row + 0.5) * height / rows - side / 2)
        for row in range(rows)
        for column in range(columns)
    ]
    cuts = "".join(f"M{x:.3f} {y:.3f}h{side:g}v{side:g}h{-side:g}z" for x, y in corners)
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width + 20:g}mm" height="{height + 35:g}mm" '
        f'viewBox="-10 -10 {width + 20:g} {height + 35:g}">\n<g fill="none" stroke-width="0.1">\n'
        f'<path id="foam" stroke="blue" d="M0 0h{width:g}v{height:g}h{-width:g}z"/>\n'
        f'<path id="patches" stroke="red" d="{cuts}"/>\n'
        f'<path id="bar" stroke="black" d="M0 {height + 10:g}h100"/>\n</g>\n'
        f'<text x="0" y="{height + 16:g}" font-size="4">100 mm: measure it. {columns} x {rows} patches of {side:g} mm '
        f"(red), foam (blue)</text>\n</svg>\n",
        encoding="utf-8",
    )


def main(folder: Path) -> None:
    """Draw all of them."""
    electrode_map(ohm.Skin.load("paper"), folder / "electrodes.png")
    wiring(folder / "wiring")
    layers(folder / "layers.png")
    patches(ohm.Skin.load("paper"), folder / "patches.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/build"))
