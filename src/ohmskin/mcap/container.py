"""Reads MCAP files that may be cut, damaged or harmful: nothing in them is believed, and all they need is bounded."""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from ohmskin.closing import Closing
from ohmskin.errors import DataError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD = 16 * 2**20
"""Bytes of one record, as stored and unpacked. Ours are a thousandth of it."""
_MOST_CHANNELS = 1024
_MOST_EXTRAS = 1024  # metadata records and attachments

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class Message:
    """One message of a container.

    Args:
        topic: Its topic.
        sequence: Its number in the container.
        log_time, publish_time: ns since 1970.
        data: Its bytes.
        place: Where it is, for `Container.message`.
    """

    topic: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    place: tuple[int, int]


class Container(Closing):
    """An MCAP file, read from its beginning, as far as it goes.

    Args:
        path: The file.

    Attributes:
        schemas, channels: By number, as far as read.
        metadata, attachments: By name, as far as read.
        damaged: How many parts had to be left out.
        end: Up to where the file could be read (byte).
        whole: Whether it was read up to its regular end.

    Raises:
        DataError: If the file cannot be opened or is no MCAP file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, Attachment] = {}
        self.damaged, self.end, self.whole = 0, 0, False
        self._loaded: tuple[int, bytes] = (-1, b"")
        try:
            self._file: BinaryIO = self.path.open("rb")
            self.size = os.fstat(self._file.fileno()).st_size
            magic = self._file.read(len(MAGIC))
        except (OSError, ValueError) as error:
            raise DataError(f"cannot read recording {self.path}: {error}") from error
        if magic != MAGIC:
            self._file.close()
            raise DataError(f"cannot read recording {self.path}: it does not begin as an MCAP file does")

    def messages(self) -> Iterator[Message]:
        """Every message that can be read, in the order of the file. What is damaged is left out and counted."""
        self.damaged, self.end, self.whole = 0, len(MAGIC), False
        while self.end + _RECORD.size <= self.size:
            start = self.end
            self._file.seek(start)
            if len(head := self._file.read(_RECORD.size)) < _RECORD.size:  # cut while it is read
                return
            opcode, length = _RECORD.unpack(head)
            if start + _RECORD.size + length > self.size or opcode == 0:
                return
            self.end = start + _RECORD.size + length
            if opcode == Opcode.DATA_END:
                self.whole = self._ends_well()
                return
            if length > LARGEST_RECORD:
                self.damaged += 1
            elif opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
                try:
                    data = self._data(start)
                except DataError:
                    self.damaged += 1
                    continue
                yield from self._within(start, data)
            elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                self._keep(opcode, self._file.read(length))

    def message(self, place: tuple[int, int]) -> bytes:
        """The bytes of a message again, by its place.

        Raises:
            DataError: If the file has changed since.
        """
        start, at = place
        if self._loaded[0] != start:
            self._loaded = (start, self._data(start))
        data = self._loaded[1]
        if at + _RECORD.size + _MESSAGE.size > len(data):
            raise DataError(f"{self.path} has changed while it was read")
        _, length = _RECORD.unpack_from(data, at)
        return data[at + _RECORD.size + _MESSAGE.size : at + _RECORD.size + length]

    def close(self) -> None:
        """Close the file. Safe twice."""
        self._file.close()

    def _data(self, start: int) -> bytes:
        """Records of the chunk at a place of the file, or the single record that is there."""
        self._file.seek(start)
        head = self._file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise DataError(f"{self.path} has changed while it was read")
        opcode, length = _RECORD.unpack(head)
        if length > LARGEST_RECORD:
            raise DataError(f"{self.path}: a part of {length} bytes; at most {LARGEST_RECORD}")
        content = self._file.read(length)
        return _unpacked(content) if opcode == Opcode.CHUNK else head + content

    def _within(self, start: int, data: bytes) -> Iterator[Message]:
        at = 0
        while at + _RECORD.size <= len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            body = at + _RECORD.size
            if body + length > len(data):
                self.damaged += 1
                return
            if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                number, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, body)
                if channel := self.channels.get(number):
                    content = data[body + _MESSAGE.size : body + length]
                    yield Message(channel.topic, sequence, log_time, publish_time, content, (start, at))
                else:
                    self.damaged += 1
            elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                self._keep(opcode, data[body : body + length])
            at = body + length

    def _keep(self, opcode: int, content: bytes) -> None:
        kind: Any = {
            Opcode.CHANNEL: Channel,
            Opcode.SCHEMA: Schema,
            Opcode.METADATA: Metadata,
            Opcode.ATTACHMENT: Attachment,
        }[Opcode(opcode)]
        try:
            record = kind.read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, ValueError, OverflowError):
            self.damaged += 1
            return
        if isinstance(record, Channel) and len(self.channels) < _MOST_CHANNELS:
            self.channels[record.id] = record
        elif isinstance(record, Schema) and len(self.schemas) < _MOST_CHANNELS:
            self.schemas[record.id] = record
        elif isinstance(record, Metadata) and len(self.metadata) < _MOST_EXTRAS:
            self.metadata[record.name] = record.metadata
        elif isinstance(record, Attachment) and len(self.attachments) < _MOST_EXTRAS:
            self.attachments[record.name] = record

    def _ends_well(self) -> bool:
        self._file.seek(max(0, self.size - len(MAGIC)))
        return self._file.read() == MAGIC and self.size > self.end


def _unpacked(content: bytes) -> bytes:
    """The records of a chunk.

    Raises:
        DataError: If it is damaged or larger than a recording's may be.
    """
    try:
        _, _, size, checksum, named = _CHUNK.unpack_from(content)
        at = _CHUNK.size + named
        compression = content[_CHUNK.size : at].decode()
        (length,) = struct.unpack_from("<Q", content, at)
        packed = content[at + 8 : at + 8 + length]
        if size > LARGEST_RECORD or len(packed) != length:
            raise DataError(f"a chunk of {size} bytes; at most {LARGEST_RECORD}")
        # never more than `size` bytes are unpacked, whatever the data say of themselves
        if compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif compression == "zstd":
            data = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD).stream_reader(packed).read(size + 1)
        elif compression == "":
            data = packed
        else:
            raise DataError(f"a chunk is compressed with {compression[:20]!r}; lz4, zstd and none can be read")
    except (struct.error, UnicodeDecodeError, RuntimeError, EOFError, zstandard.ZstdError) as error:
        raise DataError(f"a chunk is damaged: {error}") from error
    if len(data) != size or (checksum and zlib.crc32(data) != checksum):
        raise DataError(f"a chunk is damaged: {len(data)} bytes instead of {size}, or its checksum is wrong")
    return bytes(data)
