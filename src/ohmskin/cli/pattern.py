"""``ohmskin pattern``: the cutting pattern of a skin."""

from pathlib import Path

from ohmskin.cli.options import SkinName, check_picture
from ohmskin.plot.pattern import Pattern, save_pattern
from ohmskin.skin import Skin


def pattern(*, skin: SkinName = "paper", output: Path = Path("pattern.svg")) -> None:
    """Draw the cutting pattern of a skin, 1:1: outline, holes, electrodes, the seam of a sleeve, and its stretch.

    Args:
        output: SVG or PDF file to write, to scale; or a picture.
    """
    check_picture(output)
    described = Skin.load(skin)
    laid = Pattern.of(described)
    save_pattern(output, laid, described.name)
    print(f"{described.name}: {laid}\npattern: {output}")
