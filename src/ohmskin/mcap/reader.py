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
from ohmskin.mcap import messages, standard
from ohmskin.mcap.container import Container
from ohmskin.mcap.messages import Role
from ohmskin.mcap.modes import decode_modes
from ohmskin.mcap.schemas import TOPICS, contact_fields
from ohmskin.scan import DrivePattern, Frame

FORMAT = "1"
"""Version of the layout of our recordings, in their metadata."""

_MOST_MODES = 256
_LARGEST_TEXT = 2**20
_PATTERN, _FRAME, _TOUCH, _IMAGE, _, _, _LOG = TOPICS

Value = TypeVar("Value")


class LazyList(Sequence[Value], Generic[Value]):
    """Values that are each read when they are asked for.

    Args:
        read: Reads one, by a number such as a place in a file.
        numbers: (n,) the number of each.
    """

    def __init__(self, read: Callable[[int], Value], numbers: Any) -> None:
        self._read, self.numbers = read, numbers

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, index: int) -> Value: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Value]: ...
    def __getitem__(self, index: int | slice) -> Value | Sequence[Value]:
        if isinstance(index, slice):
            return LazyList(self._read, self.numbers[index])
        return self._read(int(self.numbers[index]))


class RecordingReader(Closing):
    """A recording in MCAP, indexed; the file stays open.

    Of a truncated or damaged file all valid parts are read, and `notes` reports it.

    Args:
        path: The file.

    Attributes:
        metadata: Texts by name: ``ohmskin`` (versions, when), ``device``, ``raster``.
        skin: The skin's description as TOML; empty if the file has none.
        notes: Faults of the file, in plain words.
        frames: (n,) `FrameRecord` in the order scanned, those of the calibrations included.
        times: (n,) when each frame arrived (s), 0 at the first one after the calibration; never decreasing.
        roles: (n,) purpose of each (`Role`).
        touches, images, log: `TouchRecord`, pixels (ny, nx) and sentences, in order.
        modes: Names of the modes of frames; `mode_of` numbers them.
        mode_of: (n,) mode of each frame, an index into `modes`.
        recorded_modes: Descriptions of the modes, by name: entries such as ``drive``, ``reader``, ``estimator``. Empty
            in recordings without them.

    Raises:
        DataError: If it is not an ohmskin recording, or nothing in it can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self._file = Container(path)
        self.path = self._file.path
        self._patterns = self._list(messages.decode_pattern)
        self.frames = self._list(messages.decode_frame)
        self.touches = self._list(lambda data: messages.decode_touch(data, self._contact_fields))
        self.images = self._list(standard.decode_image)
        self.log = self._list(standard.decode_log)
        self.modes: list[str] = []
        self.recorded_modes: Mapping[str, Mapping[str, Any]] = {}
        self._contact_fields = components(2)
        self._unreadable = 0
        try:
            arrived, roles, modes, patterns = self._index()
            self._describe()
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
        self.pattern_numbers: Ints = np.array(patterns, np.int64)
        self._pattern = lru_cache(256)(self._patterns.__getitem__)

    def frame(self, index: int) -> Frame:
        """Frame number `index`, from 0, with its pattern."""
        return self.frames[index].frame(self.pattern(index))

    def pattern(self, index: int) -> DrivePattern:
        """The pattern of frame number `index`, from 0."""
        return self._pattern(int(self.pattern_numbers[index]))

    def select(self, *roles: Role) -> Sequence[Frame]:
        """The frames with one of these `roles`, in order."""
        return LazyList(self.frame, np.flatnonzero(np.isin(self.roles, roles)))

    def times_of(self, listed: LazyList[Any]) -> Floats:
        """(n,) times of other messages, as in `times` (s): that of the newest frame before each.

        They follow the order
        in the file, not the system clock, which may be set during a recording.

        Args:
            listed: `touches`, `images` or `log`.
        """
        frames, others = (np.array(own.numbers, np.int64) for own in (self.frames, listed))
        return np.asarray(self.times[np.maximum(np.searchsorted(frames, others) - 1, 0)])

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        self._file.close()

    def _list(self, decode: Callable[[bytes], Value]) -> LazyList[Value]:
        """An empty list of messages, by their places in the file."""
        return LazyList(lambda place: decode(self._file.message(place)), array("Q"))

    def _index(self) -> tuple[array, array, array, array]:
        """When each frame arrived, its role, its mode and the number of its pattern."""
        arrived, roles, modes, patterns = array("d"), array("B"), array("H"), array("I")
        sizes: list[tuple[int, int]] = []
        newest: dict[int, int] = {}  # the number of the newest pattern with a digest
        known: dict[bytes, int] = {}
        lists: dict[str, LazyList] = {_TOUCH: self.touches, _IMAGE: self.images, _LOG: self.log}
        for topic, place, message in self._file.messages():
            try:
                if topic == _PATTERN:
                    if (number := known.get(message.data)) is None:
                        pattern = messages.decode_pattern(message.data)
                        number = len(self._patterns)
                        if len(known) < 4096:  # more only cost the memory of being told apart
                            known[message.data] = number
                        self._patterns.numbers.append(place)
                        sizes.append((pattern.n_meas, pattern.n_inj))
                    newest[int.from_bytes(message.data[4:8], "little")] = number
                elif topic == _FRAME:
                    record = messages.decode_frame(message.data)
                    number = newest[record.pattern]
                    if sizes[number] != (len(record.voltages), len(record.currents)):
                        raise DataError("a frame does not fit its pattern")
                    arrived.append(record.arrived)
                    roles.append(record.role)
                    modes.append(self._mode(record.mode))
                    patterns.append(number)
                    self.frames.numbers.append(place)
                elif (listed := lists.get(topic)) is not None:
                    listed.numbers.append(place)
            except (DataError, KeyError):
                self._unreadable += 1
        return arrived, roles, modes, patterns

    def _describe(self) -> None:
        """Read the file's description of itself."""
        self.metadata = {name: record.metadata for name, record in self._file.metadata.items()}
        if "ohmskin" not in self.metadata or not len(self.frames):
            topics = sorted({channel.topic[:60] for channel in self._file.channels.values()})[:12]
            found = f"{self.path} holds no frames of ohmskin; its topics are {', '.join(topics) or 'none'}"
            body = "what `ohmskin patches` recorded is replayed by `ohmskin patches BODY.toml --replay FILE`"
            raise DataError(f"{found}. Frames are recorded by `ohmskin record`; {body}")
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
        notes = []
        if not self._file.whole:
            notes.append(
                f"{self.path} is truncated: {len(self.frames)} frames can be read. "
                f"`ohmskin recover {self.path}` writes a complete copy"
            )
        if broken := self._file.damaged + self._unreadable:
            notes.append(f"{self.path}: {broken} damaged parts are left out")
        self.notes = tuple(notes)

    def _mode(self, name: str) -> int:
        if name not in self.modes:
            if len(self.modes) == _MOST_MODES:
                raise DataError("more modes than a recording can have")
            self.modes.append(name)
        return self.modes.index(name)


def is_recording(path: Path) -> bool:
    """Whether the file at a `path` begins as an MCAP file does."""
    try:
        Container(path).close()
    except DataError:
        return False
    return True
