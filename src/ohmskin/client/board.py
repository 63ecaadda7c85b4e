"""Shared memory (a "board"): the newest message of one writer, for any number of readers that never delay it.

The file (docs/guide/publishing.md has its layout) is a ring of slots. The writer fills the next slot and then says
which one is the newest; it never looks at a reader. A reader copies the newest slot and holds number and checksum
against what it copied, so that a slot written meanwhile, or seen half by another core, is noticed and read again.
"""

import json
import mmap
import os
import re
import struct
import tempfile
import time
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from stat import S_ISDIR
from typing import Any

from ohmskin.closing import Closing
from ohmskin.errors import PublishError

MAGIC = int.from_bytes(b"ohmskin2", "little")
LARGEST_BOARD = 64 * 2**20
LARGEST_SETUP = 2**20

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(\.[A-Za-z][A-Za-z0-9_]{0,31}){0,2}")
_SLOTS = 8
_BOOT, _NEWEST, _CLOSED = 4, 5, 6  # words of the head, 8 bytes each
_HEAD_BYTES = 64
_SLOT = struct.Struct("<QII")  # number of the message, its length, checksum of number and message
_NUMBER = struct.Struct("<Q")
_LOOK_AGAIN = 0.05  # seconds without anything new after which a reader looks whether there is a new board


def board_folder() -> Path:
    """The folder of this user's boards, in memory where the system has such a place; nobody else may look into it.

    Raises:
        PublishError: If somebody else owns it or may look into it, or it cannot be made.
    """
    given = os.environ.get("OHMSKIN_BOARDS")
    shared = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else Path(tempfile.gettempdir())
    folder = Path(given) if given else shared / f"ohmskin-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    try:
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700, parents=bool(given))
        found = folder.lstat()
    except OSError as error:
        what = f"cannot make the folder {folder}: {error.strerror}"
        raise PublishError(f"{what}; set OHMSKIN_BOARDS to another one") from error
    if hasattr(os, "getuid") and (not S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077):
        private = f"{folder} must be a folder that only you may use (chmod 700)"
        raise PublishError(f"{private}; remove it, or set OHMSKIN_BOARDS")
    return folder


def check_name(name: str) -> None:
    """Hold a name against what boards and topics may be called.

    Raises:
        PublishError: If it is none.
    """
    if not _NAME.fullmatch(name):
        rule = "letters, digits and '_', 32 at most, a letter first"
        raise PublishError(f"{name!r} cannot name what a skin publishes; use {rule}")


def board_path(name: str) -> Path:
    """The file of a board.

    Raises:
        PublishError: If that is no name of a board; so a name can never lead out of the folder.
    """
    check_name(name)
    return board_folder() / name


class Board(Closing):
    """The writer's side of shared memory that holds the newest message of one process.

    Args:
        name: Its name for readers; letters, digits and underscores.
        setup: What readers need once, such as the names of patches; any value that JSON can represent.
        largest: Size of the largest message (bytes).

    Raises:
        PublishError: If another program writes under this name, the name or sizes cannot be used, or memory is full.
    """

    def __init__(self, name: str, setup: Mapping[str, Any], largest: int) -> None:
        path = board_path(name)
        text = json.dumps(setup, allow_nan=False, ensure_ascii=False).encode(errors="replace")
        slots_at = -(-(_HEAD_BYTES + len(text)) // 64) * 64
        slot_bytes = -(-(_SLOT.size + largest) // 64) * 64
        size = slots_at + _SLOTS * slot_bytes
        if len(text) > LARGEST_SETUP or size > LARGEST_BOARD:
            raise PublishError(f"shared memory {name!r} would take {size} bytes; {LARGEST_BOARD} is the most")
        self._path = path
        self._lock: int | None = _lock(path, name)
        # Made beside and then renamed, so that readers keep the board of before and nobody sees half a board.
        fresh = path.with_name(f".{name}-{os.getpid()}")
        try:
            self._memory = _new_memory(fresh, size)
        except OSError as error:
            fresh.unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = None
            what = f"cannot make the shared-memory file {path}: {error.strerror}"
            raise PublishError(f"{what}; make room there, or set OHMSKIN_BOARDS to another folder") from error
        # a word is stored in one go, other than by `pack_into`
        self._words = memoryview(self._memory)[:_HEAD_BYTES].cast("Q")
        self._slots_at, self._slot_bytes, self._number = slots_at, slot_bytes, 0
        self.boot = int.from_bytes(os.urandom(8), "little") or 1
        for place, value in enumerate((MAGIC, slots_at, _SLOTS, slot_bytes, self.boot, 0, 0, len(text))):
            self._words[place] = value
        self._memory[_HEAD_BYTES : _HEAD_BYTES + len(text)] = text
        os.replace(fresh, path)

    def write(self, message: bytes) -> None:
        """Replace the previous message by `message`; never waits.

        Raises:
            PublishError: If it is larger than `largest`.
        """
        if len(message) > self._slot_bytes - _SLOT.size:
            raise PublishError(
                f"a message of {len(message)} bytes in shared memory for {self._slot_bytes - _SLOT.size}"
            )
        self._number += 1
        at = self._slots_at + self._number % _SLOTS * self._slot_bytes
        checksum = zlib.crc32(message, zlib.crc32(_NUMBER.pack(self._number)))
        _SLOT.pack_into(self._memory, at, self._number, len(message), checksum)
        at += _SLOT.size
        self._memory[at : at + len(message)] = message
        self._words[_NEWEST] = self._number

    def close(self) -> None:
        """Announce the end and remove the file; readers that have it open can still read it. Safe to call twice."""
        if self._lock is None:
            return
        self._words[_CLOSED] = 1
        self._words.release()
        self._memory.close()
        self._path.unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = None


class BoardReader(Closing):
    """A reader's side of shared memory, which need not exist yet and may be removed and made again.

    Args:
        name: Its name, given by the writer.

    Attributes:
        setup: The writer's description of itself; empty before there is a writer.

    Raises:
        PublishError: If the name is not valid.
    """

    def __init__(self, name: str) -> None:
        self._path = board_path(name)
        self._memory: mmap.mmap | None = None
        self._words: memoryview | None = None
        self._identity = (0, 0)
        self._number, self._look_at = 0, -1.0
        self.setup: dict[str, Any] = {}

    @property
    def boot(self) -> int:
        """A number that changes whenever the writer restarts; 0 before there is a writer."""
        return self._words[_BOOT] if self._words is not None else 0

    @property
    def closed(self) -> bool:
        """Whether there is no writer, or it has announced the end."""
        return self._words is None or bool(self._words[_CLOSED])

    def newest(self) -> bytes | None:
        """The newest message; None if there is none, or if it was returned before. Never waits.

        Raises:
            PublishError: If the file is not of this version.
        """
        if self._words is None or self._words[_NEWEST] == self._number:
            now = time.monotonic()
            if now < self._look_at:
                return None
            self._look_at = now + _LOOK_AGAIN
            self._open()
        if self._words is None or self._memory is None:
            return None
        for _ in range(_SLOTS):
            number = self._words[_NEWEST]
            if number == self._number:
                return None
            at = self._slots_at + number % _SLOTS * self._slot_bytes
            stated, length, checksum = _SLOT.unpack_from(self._memory, at)
            if stated == number and length <= self._slot_bytes - _SLOT.size:
                message = self._memory[at + _SLOT.size : at + _SLOT.size + length]
                if zlib.crc32(message, zlib.crc32(_NUMBER.pack(number))) == checksum:
                    self._number, self._look_at = number, time.monotonic() + _LOOK_AGAIN
                    return message
        return None  # the writer overtook us time and again; it will be here still at the next look

    def close(self) -> None:
        """Close the shared memory. Safe to call twice."""
        if self._words is not None and self._memory is not None:
            self._words.release()
            self._memory.close()
            self._words = self._memory = None
        self._identity = (0, 0)

    def _open(self) -> None:
        """Take the board that has the name now, if it is another one than before."""
        try:
            file = os.open(self._path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
        except FileNotFoundError:
            return
        except OSError as error:
            raise PublishError(f"cannot read {self._path}: {error.strerror}; check its owner") from error
        try:
            found = os.fstat(file)
            if (found.st_dev, found.st_ino) == self._identity:
                return
            if not _HEAD_BYTES < found.st_size <= LARGEST_BOARD:
                raise PublishError(
                    f"{self._path} has {found.st_size} bytes and is not of this version; restart its writer"
                )
            memory = mmap.mmap(file, found.st_size, access=mmap.ACCESS_READ)
        finally:
            os.close(file)
        words = memoryview(memory)[:_HEAD_BYTES].cast("Q")
        magic, slots_at, n_slots, slot_bytes, _, _, _, setup_bytes = words
        fits = _HEAD_BYTES + setup_bytes <= slots_at and slots_at + n_slots * slot_bytes == found.st_size
        try:
            if magic != MAGIC or n_slots != _SLOTS or slot_bytes <= _SLOT.size or not fits:
                raise ValueError("its head is damaged")
            setup = json.loads(memory[_HEAD_BYTES : _HEAD_BYTES + setup_bytes])
            if not isinstance(setup, dict):
                raise ValueError("its setup is not a table")
        except (ValueError, RecursionError) as error:
            words.release()
            memory.close()
            raise PublishError(
                f"{self._path} is not of this version of ohmskin ({error}); restart its writer"
            ) from error
        self.close()
        self._memory, self._words, self.setup = memory, words, setup
        self._slots_at, self._slot_bytes, self._number = slots_at, slot_bytes, 0
        self._identity = (found.st_dev, found.st_ino)


def _new_memory(path: Path, size: int) -> mmap.mmap:
    """A new file of so many bytes, mapped.

    They are taken now: one that is not to be had later would kill who writes to it.
    """
    path.unlink(missing_ok=True)
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file, 0, size)
        else:
            os.ftruncate(file, size)
        return mmap.mmap(file, size)
    finally:
        os.close(file)


def _lock(path: Path, name: str) -> int:
    """Keep other writers of the same name away for as long as this one lives, however it ends."""
    file = os.open(path.with_name(f".{name}.lock"), os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:  # Windows
        pass
    except OSError as error:
        os.close(file)
        advice = "wait until it has ended, or end it" if "." in name else "end it, or choose another name with --name"
        raise PublishError(f"another program writes {name!r} here; {advice}") from error
    return file
