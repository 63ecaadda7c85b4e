"""Samples of a data set for training, in splits that stay the same while it grows; and its data card."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import ohmskin
from ohmskin.dataset.recipe import Recipe
from ohmskin.errors import DataError, shown
from ohmskin.skin import Skin

SPLITS = {"train": (0, 1, 2, 3, 4, 5, 6, 7), "validation": (8,), "test": (9,)}
"""Last digits of the numbers of the samples of each split."""

_ROUND = 10


class TouchData:
    """The samples of one split, by number: a map-style data set, which PyTorch's loaders take as it is.

    Args:
        path: Folder of the data set.
        split: One of `SPLITS`; empty: all samples.

    Attributes:
        numbers: (n,) of its samples in the data set.
        arrays: The arrays of the whole data set, by name.

    Raises:
        DataError: If there is no such data set or split, or Zarr is missing.
    """

    def __init__(self, path: Path | str, split: str = "") -> None:
        if split and split not in SPLITS:
            raise DataError(f"no split {split!r}; choose from {', '.join(SPLITS)}, or leave it empty for all samples")
        try:
            import zarr
        except ImportError as error:
            raise DataError("data sets are stored by Zarr; install it: pip install 'ohmskin[dataset]'") from error
        try:
            group = zarr.open_group(str(path), mode="r")
            self.recipe: dict[str, Any] = dict(group.attrs["recipe"])  # type: ignore[arg-type]
            self.arrays: dict[str, Any] = dict(group.arrays())
            done, count = self.arrays["done"][:], self.arrays["count"].shape[0]
            self._chunk = int(self.arrays["count"].chunks[0])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path} is not a data set of `ohmskin dataset`: {error}") from error
        there = np.arange(count)[np.arange(count) % self._chunk < np.repeat(done, self._chunk)[:count]]
        self.numbers = there[np.isin(there % _ROUND, SPLITS[split])] if split else there

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, index: int) -> dict[str, np.ndarray]:
        """Arrays of one sample, by name."""
        return {name: one[0] for name, one in self._read(self.numbers[[index]]).items()}

    def batches(self, size: int, seed: int | None = None) -> Iterator[dict[str, np.ndarray]]:
        """Batches of samples, each array (size, ...), the last perhaps smaller; every chunk is read once.

        Args:
            size: Samples in a batch.
            seed: Shuffles chunks, and samples within chunks; in order without one.

        Raises:
            DataError: If `size` is not a positive whole number.
        """
        if not isinstance(size, int | np.integer) or size < 1:
            raise DataError(f"batches of {shown(size)} samples; choose a whole number, 1 or more")
        random = None if seed is None else np.random.default_rng(seed)
        left: dict[str, np.ndarray] = {}
        chunks = np.unique(self.numbers // self._chunk)
        for chunk in chunks if random is None else random.permutation(chunks):
            numbers = self.numbers[self.numbers // self._chunk == chunk]
            new = self._read(numbers if random is None else random.permutation(numbers))
            left = {name: np.concatenate([left[name], own]) for name, own in new.items()} if left else new
            while len(left["count"]) >= size:
                yield {name: own[:size] for name, own in left.items()}
                left = {name: own[size:] for name, own in left.items()}
        if left and len(left["count"]):
            yield left

    def _read(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        low, high = int(numbers.min()), int(numbers.max()) + 1
        names = ("voltages", "currents", "contacts", "count", "truth")
        return {name: self.arrays[name][low:high][numbers - low] for name in names}


def card(recipe: Recipe) -> str:
    """A data card in Markdown: what a data set is, how it was made, and what it is not good for."""
    skin, pattern = Skin.parse(recipe.skin), recipe.drive_pattern
    (least, most), (small, large), (light, hard) = recipe.contacts, recipe.radius, recipe.pressure
    converter = skin.converter
    size, gap = f"discs of {1e3 * small:g} to {1e3 * large:g} mm", f"{1e3 * recipe.gap:g} mm apart at least"
    rows = {
        "skin": f"{skin.name}, {len(skin.electrodes)} electrodes; its description is in the attribute `recipe`",
        "driven": f"{recipe.pattern}: {pattern.n_inj} injections, {pattern.n_meas} voltages a sample",
        "contacts": f"{least} to {most}, {size}, evenly over the sheet, {gap}",
        "pressure": f"{light:g} to {hard:g} Pa, evenly in its logarithm",
        "noise": f"{converter.noise:g} V rms of each voltage, {converter.bits} bits of +-{converter.full_scale:g} V",
        "seed": f"{recipe.seed}; sample i draws all from the seed sequence (seed, i)",
    }
    shares = ((name, ", ".join(map(str, digits)), 100 * len(digits) // _ROUND) for name, digits in SPLITS.items())
    splits = [f"| `{name}` | {digits} | {share} % |" for name, digits, share in shares]
    lines = [
        f"# Simulated touches of the skin {skin.name}",
        "",
        f"Made by `ohmskin dataset`, ohmskin {ohmskin.__version__}: voltages of a pressed skin, and what pressed it,",
        "as the physics twin has it.",
        *("", "| | |", "|---|---|", *(f"| {name} | {told} |" for name, told in rows.items())),
        *(
            "",
            "## Splits",
            "",
            "By the last digit of a sample's number, whatever the size of the data set.",
        ),
        *("", "| split | digits | share |", "|---|---|---|", *splits),
        *("", "## Limits", ""),
        "All samples are of one skin as it is described: no electrode is displaced, no channel is faulty, nothing",
        "drifts. Patches have 4 x 4 contacts, which changes the signal of a press by up to 7 %, across the",
        "rim by up to 13 %. Presses are even",
        "discs: no shapes, no shear, no motion; samples are independent. They do not show accuracy on a real skin.",
    ]
    return "\n".join(lines) + "\n"
