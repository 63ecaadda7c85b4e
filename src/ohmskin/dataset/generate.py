"""Makes a data set chunk by chunk, on one core, on all, or on a cluster; goes on where it was stopped."""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import ohmskin
from ohmskin.dataset.load import card
from ohmskin.dataset.recipe import Recipe
from ohmskin.errors import DataError
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.runner import spread

CHUNK = 256  # samples in a task and in a chunk of the store
_FORMAT = 2  # with names of axes, so that xarray opens it


@dataclass(frozen=True)
class Chunk:
    """Some samples in a row, as a task for any worker."""

    recipe: Recipe
    first: int
    count: int

    def run(self) -> Result:
        """The samples, by array name."""
        return self.recipe.simulate(self.first, self.count)


def generate(
    path: Path,
    recipe: Recipe,
    count: int,
    jobs: int | None = None,
    scheduler: str = "",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write `count` samples of a recipe to a Zarr group (format 3). Existing samples are kept: a stopped run continues.

    Args:
        path: Folder of the store. If it is a data set of the same recipe, missing samples are added, also to make it
            larger; it is never made smaller.
        recipe: What to make.
        count: Samples wanted.
        jobs: Processes; one per core unless given.
        scheduler: Address of a Dask scheduler to run on instead; only this process writes.
        progress: Called with samples done and wanted.

    Returns:
        Number of samples made by this call.

    Raises:
        DataError: If `path` is not a data set, is of another recipe or cannot be written, or Zarr is missing.
        OhmskinError: If the cluster cannot be used.
    """
    if not 1 <= count <= 10**10:
        raise DataError(f"{count} samples; choose 1 to 10^10")
    if jobs is not None and jobs < 1:
        raise DataError(f"{jobs} jobs; it must be 1 or more")
    try:
        import zarr
    except ImportError as error:
        raise DataError("data sets are stored by Zarr; install it: pip install 'ohmskin[dataset]'") from error
    try:
        group, done = _open(zarr, path, recipe, count)
        wanted = np.minimum(CHUNK, count - CHUNK * np.arange(-(-count // CHUNK)))
        missing = [Chunk(recipe, int(k) * CHUNK, int(wanted[k])) for k in np.flatnonzero(done[: len(wanted)] < wanted)]
        made, todo = 0, sum(chunk.count for chunk in missing)
        progress(count - todo, count)
        for chunk, samples in spread(missing, jobs or os.cpu_count() or 1, scheduler):
            for name, values in samples.items():
                group[name][chunk.first : chunk.first + chunk.count] = values
            done[chunk.first // CHUNK] = chunk.count  # last, so that a chunk cut short is made again
            made += chunk.count
            progress(count - todo + made, count)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}; free some space, or give another folder") from error
    return made


def _open(zarr: Any, path: Path, recipe: Recipe, count: int) -> tuple[Any, Any]:
    """The group, large enough for `count` samples, and how many samples of each chunk are there."""
    described = {"format": _FORMAT, "recipe": json.loads(json.dumps(asdict(recipe)))}
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        try:
            group = zarr.open_group(str(path), mode="r+", zarr_format=3)
            found = {name: group.attrs.get(name) for name in described}
        except (OSError, ValueError, KeyError) as error:
            raise DataError(f"{path} exists and is not a data set; give another folder ({error})") from error
        if found != described:
            unlike = _unlike(found, described)
            raise DataError(f"{path} was made by another recipe: {unlike}; give another folder, or the same recipe")
        for name, most in {**dict.fromkeys(recipe.arrays(), count), "done": -(-count // CHUNK)}.items():
            if most > group[name].shape[0]:  # each for itself: a run may have been stopped between two of them
                group[name].resize((most, *group[name].shape[1:]))
        return group, group["done"]
    quiet = recipe.quiet()  # what takes time comes first: a group without its attributes would not be taken for ours
    group = zarr.open_group(str(path), mode="w", zarr_format=3)

    def add(name: str, meaning: str, **settings: Any) -> None:
        group.create_array(name, **settings).attrs["meaning"] = meaning

    for name, one in recipe.arrays().items():
        shape = tuple(one.sizes.values())
        shapes = {"shape": (count, *shape), "chunks": (CHUNK, *shape), "dimension_names": ("sample", *one.sizes)}
        add(name, one.meaning, dtype=one.kind, fill_value=one.kind(one.fill), **shapes)
    pattern, (x, y) = recipe.drive_pattern, recipe.pixel_centres
    injections, measurements = pattern.injections, pattern.measurements
    for name, meaning, data, axes in (
        ("pattern_injections", "source and sink electrode of each injection, from 0", injections, "injection end"),
        ("pattern_measurements", "injection, plus and minus of each voltage", measurements, "measurement number"),
        ("quiet", "V, frames of the untouched skin", quiet, "repeat measurement"),
        ("x", "m, middles of the truth's pixels", x, "x"),
        ("y", "m, middles of the truth's pixels", y, "y"),
    ):
        add(name, meaning, data=data, dimension_names=axes.split())
    done = {"shape": (-(-count // CHUNK),), "dtype": np.int32, "chunks": (1 << 16,), "fill_value": 0}
    group.create_array("done", **done, dimension_names=("chunk",))
    with suppress(FileExistsError), path.with_name(f"{path.name}.md").open("x", encoding="utf-8") as file:
        file.write(card(recipe))
    told = {"ohmskin": ohmskin.__version__, "card": card(recipe)}
    group.attrs.update({**described, **told})  # last: without it this is not a data set
    return group, group["done"]


def _unlike(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    if found["format"] != wanted["format"] or not isinstance(found["recipe"], dict):
        return f"format {found['format']}, not {wanted['format']}"
    here, there = wanted["recipe"], found["recipe"]
    name = next(name for name in here if here[name] != there.get(name))
    return "another skin" if name == "skin" else f"{name} {there.get(name)}, not {here[name]}"
