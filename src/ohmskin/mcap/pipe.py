"""The loop's end of a recording: a pipe to a writer in a process of its own; nothing here ever waits."""

import json
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ohmskin.child import Child
from ohmskin.errors import DataError
from ohmskin.mcap.schemas import FRAME, HEALTH, IMAGE, LOG, MARKERS, PATTERN, PREFIX, TOPICS, TOUCH

_START_TIMEOUT = 30.0
_STOP_TIMEOUT = 30.0
_PIPE_BYTES = 2**20  # as much as Linux allows without privileges

_MOST_WAITING = {IMAGE: 2**19, MARKERS: 2**20, HEALTH: 2**21, LOG: 2**21, TOUCH: 2**22, PATTERN: 2**24, FRAME: 2**24}
"""Bytes waiting beyond which a message of a topic is dropped: pictures go first, frames last."""


@dataclass(frozen=True)
class Progress:
    """State of a recording: what was written and dropped.

    Args:
        written: Bytes in the file.
        frames: Frames written.
        dropped: Messages dropped, by topic: the writer or the disk was too slow.
        trouble: Why nothing can be written now; empty while writing succeeds.
    """

    written: int = 0
    frames: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    trouble: str = ""


class WriterPipe:
    """A writer process and the pipe to it.

    Args:
        path: The recording, a file that does not exist yet.
        metadata, attachments: See `RecordingWriter`.

    Raises:
        DataError: If the file is there already or cannot be made.
    """

    def __init__(self, path: str | Path, metadata: dict[str, dict[str, str]], attachments: dict[str, str]) -> None:
        self.path = Path(path)
        if os.path.exists(self.path):
            raise DataError(f"{self.path} exists, and a recording is never overwritten; choose another name")
        self._dropped = dict.fromkeys(TOPICS, 0)
        self._waiting: deque[tuple[int, bytes]] = deque()  # topic, and what is still to be written of a message
        self._size = 0
        self._lock = threading.Lock()
        self._answers = b""
        self._said: dict[str, Any] = {}
        self._closed = False
        settings = {"path": str(self.path), "metadata": metadata, "attachments": attachments}
        self._child = Child.module("ohmskin.mcap.process", "the writer's process", settings)
        self._child.ready(_START_TIMEOUT, lambda why: DataError(f"cannot record to {self.path}: {why}; choose another"))
        self._in, self._out = self._child.stdin.fileno(), self._child.stdout.fileno()
        self._widen()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)

    @property
    def pid(self) -> int:
        """Number of the writer's process."""
        return self._child.process.pid

    @property
    def waiting(self) -> int:
        """Bytes that the pipe has not taken yet."""
        return self._size

    @property
    def progress(self) -> Progress:
        """State of the recording a fraction of a second ago; also sends what waits."""
        with self._lock:
            if not self._closed:
                self._push()
            self._listen()
            said = self._said
            trouble = said.get("trouble", "")
            if self._child.process.poll() is not None and not said.get("closed"):
                trouble = f"the writer's process has ended (exit status {self._child.process.returncode})"
            dropped = {topic: count for topic, count in self._dropped.items() if count}
            if lost := said.get("lost", 0):
                dropped["all topics, by the writer"] = lost
            return Progress(said.get("written", 0), said.get("frames", 0), dropped, trouble)

    def send(self, topic: int, sequence: int, stamp: int, data: bytes) -> bool:
        """Send one message to the writer. Never waits.

        Args:
            topic: Its number in `TOPICS`.
            sequence: Number of the message; its lowest 32 bits are kept.
            stamp: When, in ns since 1970.
            data: The message, encoded.

        Returns:
            False if it had to be dropped.
        """
        with self._lock:
            if self._closed:
                return False
            self._listen()  # or the writer would wait for somebody to read what it says, as soon as that fills its pipe
            if self._size and self._size + len(data) > _MOST_WAITING[topic]:
                self._push()
                if self._size and self._size + len(data) > _MOST_WAITING[topic]:
                    self._dropped[list(TOPICS)[topic]] += 1
                    return False
            message = PREFIX.pack(topic, sequence & 0xFFFFFFFF, stamp, len(data)) + data
            self._waiting.append((topic, message))
            self._size += len(message)
            self._push()
            return True

    def close(self) -> Progress:
        """Write the rest, finish the file, and return its last `progress`. Safe to call twice."""
        with self._lock:
            if not self._closed:
                self._closed = True
                end = time.monotonic() + _STOP_TIMEOUT
                while self._size and self._child.process.poll() is None and time.monotonic() < end:
                    self._push()
                    if self._size:
                        time.sleep(0.002)
                self._child.end(max(0.1, end - time.monotonic()))
                self._listen()
                self._child.close()
        return self.progress

    def _push(self) -> None:
        """Write as much as the pipe takes."""
        try:
            while self._waiting:
                topic, first = self._waiting[0]
                done = os.write(self._in, first)
                self._size -= done
                if done < len(first):
                    self._waiting[0] = topic, first[done:]
                else:
                    self._waiting.popleft()
        except BlockingIOError:
            pass
        except OSError:  # the writer's process has gone, which `progress` tells
            for topic, _ in self._waiting:
                self._dropped[list(TOPICS)[topic]] += 1
            self._waiting.clear()
            self._size = 0

    def _listen(self) -> None:
        if self._child.stdout.closed:
            return
        with suppress(BlockingIOError, ValueError):
            while data := os.read(self._out, 65536):
                *lines, self._answers = (self._answers + data).split(b"\n")
                for line in lines:
                    self._said |= json.loads(line)

    def _widen(self) -> None:
        with suppress(ImportError, AttributeError, OSError):
            import fcntl

            fcntl.fcntl(self._in, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
