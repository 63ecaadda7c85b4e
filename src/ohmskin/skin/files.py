"""Skin files as they are written."""

from itertools import count
from pathlib import Path

from ohmskin.errors import DataError
from ohmskin.skin.description import Skin


def write(path: Path, text: str) -> None:
    """Write a file, or raise DataError."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}; choose another place") from error


def save_skin(path: Path, skin: Skin) -> Path | None:
    """Write a skin's file; one that was there is kept under another name.

    Args:
        path: The file to write.
        skin: The skin.

    Returns:
        Where the file is that was there; None if there was none.

    Raises:
        DataError: If it cannot be written.
    """
    if not path.is_file():
        write(path, skin.dump())
        return None
    kept = next(name for k in count(1) if not (name := path.with_stem(f"{path.stem}-before-{k}")).exists())
    fresh = path.with_name(f"{path.name}.new")
    write(fresh, skin.dump())
    try:
        path.rename(kept)
        fresh.rename(path)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error}; the skin is in {fresh}") from error
    return kept
