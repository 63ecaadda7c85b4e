"""A recording of ours: frames, cycles and images in the order they happened, read when asked for."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.client.fields import components
from ohmskin.closing import Closing
from ohmskin.errors import DataError
from ohmskin.mcap import messages
from ohmskin.mcap.container import MAGIC, Container
from ohmskin.mcap.messages import FrameRecord, Role, TouchRecord
from ohmskin.mcap.modes import decode_modes
from ohmskin.mcap.schemas import TOPICS, contact_fields
from ohmskin.scan import DrivePattern, Frame

FORMAT = "1"
"""Version of the layout of our recordings, in their metadata."""

_MOST_MODES = 256
_LARGEST_TEXT = 2**20
_PATTERN, _FRAME, _TOUCH, _IMAGE, _, _, _LOG = TOPICS

Value = TypeVar("Value")


class MessageList(Sequence[Value], Generic[Value]):
    """Messages of one kind, each read and unpacked when it is asked for.

    Attributes:
        stamps: (n,) when each was recorded (ns since 1970).
        sequences: (n,) number of each in the file.
    """

    def __init__(self, read: Callable[[tuple[int, int]], Value]) -> None:
        self._read = read
        self._starts, self._offsets, self._stamps, self._sequences = array("Q"), array("I"), array("q"), array("I")

    def put(self, place: tuple[int, int], stamp: int, sequence: int) -> None:
        self._starts.append(place[0])
        self._offsets.append(place[1])
        self._stamps.append(min(stamp, 2**63 - 1))
        self._sequences.append(sequence)

    @property
    def order(self) -> Ints:
        """(n,) grows with the place in the file."""
        return (np.array(self._starts, np.int64) << 25) + np.array(self._offsets, np.int64)

    @property
    def stamps(self) -> Ints:
        return np.array(self._stamps, np.int64)

    @property
    def sequences(self) -> Ints:
        return np.array(self._sequences, np.int64)

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, index: int) -> Value: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Value]: ...
    def __getitem__(self, index: int | slice) -> Value | Sequence[Value]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return self._read((self._starts[index], self._offsets[index]))


class Tape(Closing):
    """A recording in MCAP, indexed; the file stays open.

    A file that was cut short, or has damaged parts, is read as far as it goes, and `notes` says so.

    Args:
        path: The file.

    Attributes:
        metadata: Texts by name: ``ohmskin`` (versions, when), ``device``, ``raster``.
        skin: The skin's description as TOML; empty if the file has none.
        notes: What is wrong with the file, in plain words.
        frames: (n) `FrameRecord` in the order scanned, those of the calibrations included.
        times: (n,) when each frame arrived (s), 0 at the first one behind the calibration; never decreasing.
        roles: (n,) what each was scanned for (`Role`).
        touches, images, log: `TouchRecord`, pixels (ny, nx) and sentences, in order.
        modes: Names of the modes of frames; `mode_of` numbers them.
        mode_of: (n,) mode of each frame, an index into `modes`.
        recorded_modes: What the recorder told of modes, by name: entries such as ``drive``, ``reader``, ``estimator``.
            Empty in recordings that do not tell.

    Raises:
        DataError: If it is not a recording of ours, or nothing in it can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self._file = Container(path)
        self.path = self._file.path
        self._patterns: list[tuple[int, int]] = []
        self._pattern_of = array("I")
        self.frames: MessageList[FrameRecord] = MessageList(
            lambda place: messages.decode_frame(self._file.message(place))
        )
        self.touches: MessageList[TouchRecord] = MessageList(
            lambda place: messages.decode_touch(self._file.message(place), self._contact_fields)
        )
        self.images: MessageList[Floats] = MessageList(lambda place: messages.decode_image(self._file.message(place)))
        self.log: MessageList[str] = MessageList(lambda place: messages.decode_log(self._file.message(place)))
        self.modes: list[str] = []
        self.recorded_modes: Mapping[str, Mapping[str, Any]] = {}
        self._contact_fields = components(2)
        self._unreadable = 0
        arrived, roles, modes = array("d"), array("B"), array("H")
        try:
            self._index(arrived, roles, modes)
        except OSError as error:
            self.close()
            raise DataError(f"cannot read recording {path}: {error}") from error
        except DataError:
            self.close()
            raise
        times = np.array(arrived)
        self.roles: Ints = np.array(roles, np.int64)
        zero = int(np.argmax(self.roles != Role.QUIET))
        self.times: Floats = np.maximum.accumulate(times) - float(times[: zero + 1].max())
        self.mode_of: Ints = np.array(modes, np.int64)
        self._pattern_at = lru_cache(256)(
            lambda number: messages.decode_pattern(self._file.message(self._patterns[number]))
        )
        self.notes = self._notes()

    def frame(self, index: int) -> Frame:
        """One frame with its pattern."""
        return self.frames[index].frame(self.pattern(index))

    def pattern(self, index: int) -> DrivePattern:
        """The pattern of one frame."""
        return self._pattern_at(self._pattern_of[index])

    def select(self, *roles: Role) -> Sequence[Frame]:
        """The frames scanned for one of these purposes, in order."""
        return _Selection(self, np.flatnonzero(np.isin(self.roles, roles)))

    def times_of(self, listed: MessageList[Any]) -> Floats:
        """(n,) times of `touches`, `images` or `log` (s), as in `times`: that of the newest frame before each.

        By the order in the file and not by the calendar, which may be set anew in the middle of a recording.
        """
        newest = np.searchsorted(self.frames.order, listed.order) - 1
        return np.asarray(self.times[np.maximum(newest, 0)])

    @property
    def pattern_numbers(self) -> Ints:
        """(n,) which frames share a pattern: the number of each frame's."""
        return np.array(self._pattern_of, np.int64)

    def close(self) -> None:
        """Close the file. Safe twice."""
        self._file.close()

    def _index(self, arrived: Any, roles: Any, modes: Any) -> None:
        sizes: list[tuple[int, int]] = []
        newest: dict[int, int] = {}  # the number of the newest pattern with a digest
        known: dict[bytes, int] = {}
        lists: dict[str, MessageList] = {_TOUCH: self.touches, _IMAGE: self.images, _LOG: self.log}
        for message in self._file.messages():
            try:
                if message.topic == _PATTERN:
                    if (number := known.get(message.data)) is None:
                        pattern = messages.decode_pattern(message.data)
                        number = len(self._patterns)
                        if len(known) < 4096:  # more only cost the memory of being told apart
                            known[message.data] = number
                        self._patterns.append(message.place)
                        sizes.append((pattern.n_meas, pattern.n_inj))
                    newest[int.from_bytes(message.data[4:8], "little")] = number
                elif message.topic == _FRAME:
                    head = messages.frame_head(message.data)
                    number = newest[head.pattern]
                    if sizes[number] != (head.n_meas, head.n_inj):
                        raise DataError("a frame does not fit its pattern")
                    arrived.append(head.arrived)
                    roles.append(head.role)
                    modes.append(self._mode(head.mode))
                    self._pattern_of.append(number)
                    self.frames.put(message.place, message.log_time, message.sequence)
                elif (listed := lists.get(message.topic)) is not None:
                    listed.put(message.place, message.log_time, message.sequence)
            except (DataError, KeyError):
                self._unreadable += 1
        self.metadata = self._file.metadata
        if "ohmskin" not in self.metadata or not len(self.frames):
            topics = ", ".join(self._topics()) or "none"
            raise DataError(f"{self.path} holds no frames of ohmskin; its topics are {topics}")
        if (version := self.metadata["ohmskin"].get("format", "")) != FORMAT:
            ours = f"this version of ohmskin reads layout {FORMAT!r}: install a newer one"
            raise DataError(f"{self.path} has layout {version[:20]!r}; {ours}")
        for schema in self._file.schemas.values():
            if schema.name == TOPICS[_TOUCH][0]:
                self._contact_fields = contact_fields(schema.data.decode(errors="replace"))
        with suppress(DataError):  # damaged: as if it had not been told
            self.recorded_modes = decode_modes(self.metadata["ohmskin"].get("modes", "{}"))
        attached = self._file.attachments.get("skin.toml")
        content = attached.data if attached else b""
        if len(content) > _LARGEST_TEXT:
            raise DataError(f"{self.path}: its skin.toml has {len(content)} bytes; at most {_LARGEST_TEXT}")
        self.skin = content.decode(errors="replace")

    def _topics(self) -> list[str]:
        return sorted({channel.topic[:60] for channel in self._file.channels.values()})[:12]

    def _mode(self, name: str) -> int:
        if name not in self.modes:
            if len(self.modes) == _MOST_MODES:
                raise DataError("more modes than a recording can have")
            self.modes.append(name)
        return self.modes.index(name)

    def _notes(self) -> tuple[str, ...]:
        notes = []
        if not self._file.whole:
            notes.append(
                f"{self.path} was cut short: {len(self.frames)} frames can be read. "
                f"`ohmskin recover {self.path}` writes a whole copy"
            )
        if broken := self._file.damaged + self._unreadable:
            notes.append(f"{self.path}: {broken} damaged parts are left out")
        return tuple(notes)


def is_tape(path: Path) -> bool:
    """Whether a file begins as an MCAP file does."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return False


class _Selection(Sequence[Frame]):
    """Some of a tape's frames, each read when it is asked for."""

    def __init__(self, tape: Tape, indices: Ints) -> None:
        self._tape, self._indices = tape, indices

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        if isinstance(index, slice):
            return _Selection(self._tape, self._indices[index])
        return self._tape.frame(int(self._indices[index]))
