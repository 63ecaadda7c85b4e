"""Writes recordings: MCAP in small chunks, each on its way to the disk as soon as it is whole."""

import os
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, IndexType, Writer

from ohmskin.mcap.schemas import FRAME, PATTERN, TOPICS

CHUNK_BYTES = 16 * 1024
CHUNK_FRAMES = 4  # what a crash of loop and writer may cost, beside what is in the pipe
CHUNK_SECONDS = 0.05
MOST_UNWRITTEN = 4 * 2**20  # bytes kept while the disk takes none
MOST_OWED = 1024  # patterns kept beside them
RETRY_AFTER = 1.0
SYNC_EVERY = 5.0  # seconds; what a power cut may cost


class Disk:
    """A new file that takes whole parts or nothing of them: what does not fit is kept and tried again.

    Attributes:
        written: Bytes in the file.
        frames: Frames in it.

    Raises:
        OSError: If the file cannot be made; FileExistsError if it is there.
    """

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._open = bytearray()
        self._parts: deque[tuple[bytes, int, int]] = deque()  # each with how many frames and messages are in it
        self._pending = 0
        self.written = self.frames = 0
        self._synced, self._retry_at = time.monotonic(), 0.0
        self._syncing: threading.Thread | None = None
        self.trouble = ""

    @property
    def full(self) -> bool:
        """Whether no more should be handed over until a `commit` succeeds."""
        return self._pending > MOST_UNWRITTEN

    def write(self, data: bytes) -> int:
        self._open += data
        self._pending += len(data)
        return len(data)

    def tell(self) -> int:
        return self.written + self._pending

    def flush(self) -> None:
        """Nothing: `commit` writes."""

    @property
    def unwritten(self) -> int:
        """Messages of the parts that wait for room."""
        return sum(messages for *_, messages in self._parts)

    def commit(self, now: bool = False, frames: int = 0, messages: int = 0) -> None:
        """End a part with so many frames and messages, and write what waits; after a failure once a second or `now`."""
        if self._open:
            self._parts.append((bytes(self._open), frames, messages))
            self._open.clear()
        if not self._parts or (self.trouble and not now and time.monotonic() < self._retry_at):
            return
        while self._parts:
            part, frames, _ = self._parts[0]
            try:
                done = 0
                while done < len(part):
                    done += os.write(self._file, part[done:])
            except OSError as error:
                self.trouble, self._retry_at = error.strerror or str(error), time.monotonic() + RETRY_AFTER
                with suppress(OSError):
                    os.ftruncate(self._file, self.written)
                    os.lseek(self._file, self.written, os.SEEK_SET)
                return
            self._parts.popleft()
            self._pending -= len(part)
            self.written += len(part)
            self.frames += frames
        self.trouble = ""
        if time.monotonic() - self._synced > SYNC_EVERY and not (self._syncing and self._syncing.is_alive()):
            # a slow disk takes a second for this, in which the pipe would fill
            self._syncing = threading.Thread(target=self._sync, daemon=True)
            self._syncing.start()
            self._synced = time.monotonic()

    def close(self) -> None:
        if self._syncing:
            self._syncing.join()
        self._sync()
        os.close(self._file)

    def _sync(self) -> None:
        with suppress(OSError):  # what failed to be written shows at the next write
            os.fsync(self._file)


class _Indexes:
    """Chunk indexes as the bytes they will be in the file: a tenth of the memory, and a long recording has millions."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._bytes += builder.end()

    def __iter__(self) -> Iterator["_Indexes"]:
        if self._bytes:
            yield self

    def write(self, builder: RecordBuilder) -> None:
        builder.write(self._bytes)


def open_writer(disk: Any, chunk_size: int) -> Writer:
    """An MCAP writer that starts with no channels, its indexes kept small."""
    writer = Writer(disk, chunk_size=chunk_size, compression=CompressionType.LZ4, index_types=IndexType.ALL)
    # a detail of the package; without it only memory grows
    if isinstance(getattr(writer, "_Writer__chunk_indices", None), list):
        writer._Writer__chunk_indices = _Indexes()  # type: ignore[attr-defined]
    return writer


class RecordingWriter:
    """A recording being written.

    Args:
        path: The file, which must not be there yet.
        metadata: Texts by record and name.
        attachments: Texts by file name, such as the skin's description.

    Attributes:
        lost: Messages given up because the disk took none.

    Raises:
        OSError: If the file cannot be made.
    """

    def __init__(self, path: str, metadata: dict[str, dict[str, str]], attachments: dict[str, str]) -> None:
        self.disk = Disk(path)
        self.lost = 0
        self._recent = self._count = 0  # frames and messages of the chunk in progress
        self._owed: dict[bytes, tuple[int, int, int, bytes]] = {}  # patterns that later frames will refer to
        self._due = float("inf")
        self._writer = open_writer(self.disk, 2**30)  # chunks end where `_add` says
        self._writer.start("ros2", library="ohmskin")
        for name, entries in metadata.items():
            self._writer.add_metadata(name, entries)
        for name, text in attachments.items():
            self._writer.add_attachment(time.time_ns(), time.time_ns(), name, "text/plain", text.encode())
        for topic, (kind, definition) in TOPICS.items():
            schema = self._writer.register_schema(kind, "ros2msg", definition.encode())
            self._writer.register_channel(topic, "cdr", schema)
        self._size = 0
        self._writer.flush()
        self.disk.commit(now=True)

    def add(self, topic: int, sequence: int, stamp: int, data: bytes) -> None:
        """Add one message; `topic` by its number in `TOPICS`, `stamp` in ns since 1970."""
        if self.disk.full:
            self.disk.commit()
        if self.disk.full:
            if topic == PATTERN and len(self._owed) < MOST_OWED:
                self._owed[data] = (topic, sequence, stamp, data)
            else:
                self.lost += 1
            return
        while self._owed:
            self._add(*self._owed.pop(next(iter(self._owed))))
        self._add(topic, sequence, stamp, data)

    def _add(self, topic: int, sequence: int, stamp: int, data: bytes) -> None:
        if self._due == float("inf"):
            self._due = time.monotonic() + CHUNK_SECONDS
        self._writer.add_message(topic + 1, stamp, data, stamp, sequence)
        self._size += len(data) + 31
        self._count += 1
        if topic == FRAME:
            self._recent += 1
        if self._size >= CHUNK_BYTES or self._recent >= CHUNK_FRAMES or time.monotonic() > self._due:
            self.flush()

    @property
    def wait(self) -> float | None:
        """Seconds until `flush` is due; None if nothing is kept."""
        if self._due < float("inf"):
            return max(0.0, self._due - time.monotonic())
        return RETRY_AFTER if self.disk.trouble else None

    def flush(self) -> None:
        """End the chunk in progress and hand it to the system."""
        self._writer.flush()
        frames, messages, self._recent, self._count, self._size = self._recent, self._count, 0, 0, 0
        self._due = float("inf")
        self.disk.commit(frames=frames, messages=messages)

    def close(self) -> None:
        """Write the index and close. Without room for it the file stays one that `ohmskin recover` mends."""
        self.flush()
        self.disk.commit(now=True)
        self.lost += self.disk.unwritten
        self._writer.finish()
        self.disk.commit(now=True)
        self.disk.close()
