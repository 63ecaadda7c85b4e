"""One sensor beside the electrodes that feels all of the skin at once: a load cell behind it, or the air under it."""

from dataclasses import dataclass

from ohmskin.skin.checks import choice, number


@dataclass(frozen=True)
class Auxiliary:
    """The auxiliary channel of an instrument.

    Args:
        kind: ``force``: the total force (N) on the skin; ``pressure``: that of the air under it (Pa); empty: none.
        gain: What it reads for one newton more on the skin (N/N or Pa/N).
        noise: Standard deviation of a reading (N or Pa).
        error: By how much its gain may be off from place to place (1).
    """

    kind: str = choice("", "", "force", "pressure")
    gain: float = number(1.0, 1e-9, 1e9, "N/N or Pa/N")
    noise: float = number(0.05, 0, 1e9, "N or Pa")
    error: float = number(0.02, 0, 1)
