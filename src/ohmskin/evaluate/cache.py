"""Results on disk, one file per experiment, so that a run that was killed goes on where it stopped."""

import hashlib
import json
import os
import zipfile
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import ohmskin
from ohmskin.errors import OhmskinError
from ohmskin.evaluate.result import Experiment, Result

# what results do not depend on: other packages, and what comes after the results
_BESIDE = {"bench", "body", "calibrate", "cli", "client", "dataset", "device", "engine", "importers", "mcap", "outlets"}
_BESIDE |= {"plot", "recording", "robot", "view"}
_AFTER = {
    "assumed",
    "cache",
    "claims",
    "comparison",
    "figures",
    "goals",
    "paper",
    "plan",
    "report",
    "reproduction",
    "resolution",
}
_AFTER |= {"runner", "statistics", "study", "verdict"}


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """The version of ohmskin and a checksum of the source that results depend on: another one computes them anew."""
    root = Path(ohmskin.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(p for pattern in ("*/**/*.py", "*/**/*.toml") for p in root.glob(pattern)):
        part = path.relative_to(root)
        after = part.parts[0] == "evaluate" and not _AFTER.isdisjoint(part.with_suffix("").parts)
        if part.parts[0] not in _BESIDE and not after:
            digest.update(str(part).encode() + path.read_bytes())
    return f"{ohmskin.__version__}+{digest.hexdigest()[:16]}"


def describe(task: Experiment) -> dict[str, Any]:
    """The name and the parameters of an experiment, as JSON can hold them."""
    return {"experiment": type(task).__name__, **asdict(task)}  # type: ignore[call-overload]


def key(task: Experiment) -> str:
    """A name for an experiment with these parameters under this version, fit for a file."""
    text = json.dumps([fingerprint(), describe(task)], sort_keys=True)
    return f"{type(task).__name__.lower()}-{hashlib.sha256(text.encode()).hexdigest()[:20]}"


class Cache:
    """A folder of results.

    Args:
        folder: Where; made if it is not there.

    Raises:
        OhmskinError: If it cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OhmskinError(f"cannot make the cache folder {folder}: {error}; give another with --cache") from error

    def load(self, task: Experiment) -> Result | None:
        """The result kept for an experiment; None if there is none or the file is damaged."""
        try:
            with self._file(task).open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
                return {name: kept[name] for name in kept.files if name != "_task"}
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return None

    def save(self, task: Experiment, result: Result) -> None:
        """Keep a result; the file is complete or not there.

        Raises:
            OhmskinError: If it cannot be written.
        """
        target = self._file(task)
        part = target.with_suffix(f".{os.getpid()}.part")
        try:
            with part.open("wb") as stream:
                kept: dict[str, Any] = {"_task": np.array(json.dumps(describe(task))), **result}
                np.savez_compressed(stream, **kept)
            os.replace(part, target)
        except OSError as error:
            text = f"cannot write {target}: {error}; free some space or give another folder with --cache"
            raise OhmskinError(text) from error

    def _file(self, task: Experiment) -> Path:
        return self.folder / f"{key(task)}.npz"
