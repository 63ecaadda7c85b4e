"""What takes seconds to make, kept between starts in the user's folder for such things.

The name of a file is a digest of all that went into what it holds, of the source that makes it and of the versions
that this runs on, so that nothing stale is read. What is damaged is made anew; so is all where nothing can be written.
"""

import hashlib
import io
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from platformdirs import user_cache_path

Arrays = dict[str, NDArray[Any]]
LARGEST, ROOM = 64 * 2**20, 512 * 2**20  # bytes of one, and of all, of which the longest unused ones go
_MAKERS = ("geometry", "scan", "forward", "drive")  # packages whose results are kept


def cache_folder() -> Path:
    """Where they are: the folder named by OHMSKIN_CACHE, or `ohmskin` where this system keeps such files."""
    given = os.environ.get("OHMSKIN_CACHE")
    return Path(given) if given else user_cache_path("ohmskin", appauthor=False)


def cached(
    name: str, inputs: tuple[NDArray[np.generic] | float | str | None, ...], make: Callable[[], Arrays]
) -> Arrays:
    """What `make` gave when it was last called with the same inputs on this machine, or gives now.

    Args:
        name: Of what is made.
        inputs: All that it depends on.
        make: Makes it: arrays by name.
    """
    path = cache_folder() / f"{name}-{_digest(name, *inputs)}"
    with suppress(Exception):  # whatever a damaged file raises, it is made anew
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            found = {key: kept[key] for key in kept.files}
        os.utime(path)
        return found
    made = make()
    if sum(one.nbytes for one in made.values()) < LARGEST:
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **made)
        with suppress(OSError):
            _write(path, content.getvalue())
    return made


def _write(path: Path, content: bytes) -> None:
    """Write it whole or not at all; what was longest unused makes room."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix="new-")
    try:
        with open(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except OSError:
        os.unlink(temporary)
        raise
    found = [(one.stat(), one) for one in path.parent.iterdir()]
    left = sum(stat.st_size for stat, _ in found)
    for stat, one in sorted(found, key=lambda pair: pair[0].st_mtime):
        if left <= ROOM:
            break
        one.unlink(missing_ok=True)
        left -= stat.st_size


def _digest(*inputs: NDArray[np.generic] | float | str | None) -> str:
    found = hashlib.blake2b(_source(), digest_size=16)
    for one in inputs:
        if isinstance(one, np.ndarray):
            found.update(repr((one.dtype.str, one.shape)).encode())
            found.update(np.ascontiguousarray(one).view(np.uint8).data)
        else:
            found.update(repr(one).encode())
        found.update(b"\0")
    return found.hexdigest()


@cache
def _source() -> bytes:
    """A digest of the source that makes what is kept, and of the versions that it runs on."""
    root = Path(__file__).parent
    found = hashlib.blake2b(repr((sys.version, np.__version__, scipy.__version__)).encode(), digest_size=16)
    for file in sorted(file for package in _MAKERS for file in (root / package).glob("*.py")):
        found.update(file.read_bytes())
    return found.digest()
