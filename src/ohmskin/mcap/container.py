"""Reads MCAP files that may be cut, damaged or harmful: nothing in them is believed, and all they need is bounded."""

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema

from ohmskin.closing import Closing
from ohmskin.errors import DataError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD = 16 * 2**20
"""Bytes of one record, as stored and unpacked. Ours are a thousandth of it."""
_WITHIN = 2 * LARGEST_RECORD  # a place is that of a record in the file times this, plus that of a message within it
_MOST_UNPACKED = 256  # times the size of the file, and one record: lz4 packs zeros to a 255th
_MOST_KEPT = 1024  # schemas, channels, metadata records, attachments

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


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
        self.metadata: dict[str, Metadata] = {}
        self.attachments: dict[str, Attachment] = {}
        self._kept: dict[int, tuple[Any, dict]] = {
            Opcode.SCHEMA: (Schema, self.schemas),
            Opcode.CHANNEL: (Channel, self.channels),
            Opcode.METADATA: (Metadata, self.metadata),
            Opcode.ATTACHMENT: (Attachment, self.attachments),
        }
        self.damaged, self.end, self.whole = 0, 0, False
        self._loaded: tuple[int, bytes] = (-1, b"")
        try:
            if self.path.is_fifo():
                raise OSError("it is a pipe, which may never end")
            self._file: BinaryIO = self.path.open("rb")
            self.size = os.fstat(self._file.fileno()).st_size
            magic = self._file.read(len(MAGIC))
        except (OSError, ValueError) as error:
            raise DataError(f"cannot read recording {self.path}: {error}") from error
        if magic != MAGIC:
            self._file.close()
            raise DataError(f"cannot read recording {self.path}: it does not begin as an MCAP file does")

    def messages(self) -> Iterator[tuple[str, int, Message]]:
        """Topic, place and record of every message that can be read, in the order of the file.

        What is damaged is left out and counted. Places grow; `message` takes them.
        """
        self.damaged, self.end, self.whole = 0, len(MAGIC), False
        left = LARGEST_RECORD + _MOST_UNPACKED * self.size
        while head := self._head(self.end):
            (opcode, length), start = head, self.end
            if start + _RECORD.size + length > self.size or opcode == 0:
                return
            self.end = start + _RECORD.size + length
            if opcode == Opcode.DATA_END:
                self._file.seek(max(0, self.size - len(MAGIC)))
                self.whole = self._file.read() == MAGIC and self.size > self.end
                return
            if length > LARGEST_RECORD:
                self.damaged += 1
            elif opcode in (Opcode.CHUNK, Opcode.MESSAGE) or opcode in self._kept:
                try:
                    data = self._data(*head)
                except DataError:
                    self.damaged += 1
                    continue
                if (left := left - len(data)) < 0:
                    told = f"{self.path} unpacks to more than {_MOST_UNPACKED} times its size"
                    raise DataError(f"{told}, as no recording does; it is damaged, or malicious")
                yield from self._within(start, data)

    def message(self, place: int) -> bytes:
        """The bytes of a message again, by its place.

        Raises:
            DataError: If the file has changed since.
        """
        start, at = divmod(place, _WITHIN)
        if self._loaded[0] != start:
            head = self._head(start)
            self._loaded = start, self._data(*head) if head and head[1] <= LARGEST_RECORD else b""
        data = self._loaded[1]
        if at + _RECORD.size + _MESSAGE.size > len(data):
            raise DataError(f"{self.path} has changed while it was read; read it again")
        _, length = _RECORD.unpack_from(data, at)
        return data[at + _RECORD.size + _MESSAGE.size : at + _RECORD.size + length]

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        self._file.close()

    def _head(self, start: int) -> tuple[int, int] | None:
        """Opcode and length of the record at a place of the file; None where the file ends."""
        self._file.seek(start)
        head = self._file.read(_RECORD.size)
        return _RECORD.unpack(head) if len(head) == _RECORD.size else None

    def _data(self, opcode: int, length: int) -> bytes:
        """Records of the chunk whose head was just read, or the single record that it is."""
        content = self._file.read(length)
        return _unpacked(content) if opcode == Opcode.CHUNK else _RECORD.pack(opcode, length) + content

    def _within(self, start: int, data: bytes) -> Iterator[tuple[str, int, Message]]:
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
                    message = Message(number, log_time, content, publish_time, sequence)
                    yield channel.topic, start * _WITHIN + at, message
                else:
                    self.damaged += 1
            elif opcode in self._kept:
                self._keep(opcode, data[body : body + length])
            at = body + length

    def _keep(self, opcode: int, content: bytes) -> None:
        kind, kept = self._kept[opcode]
        try:
            record = kind.read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, ValueError, OverflowError):
            self.damaged += 1
            return
        if len(kept) < _MOST_KEPT:
            kept[record.id if isinstance(record, Schema | Channel) else record.name] = record


def _unpacked(content: bytes) -> bytes:
    """The records of a chunk.

    Raises:
        DataError: If it is damaged or larger than a recording's may be.
    """
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        packed, size = chunk.data, chunk.uncompressed_size
        if size > LARGEST_RECORD:
            raise ValueError(f"it has {size} bytes; at most {LARGEST_RECORD}")
        # never more than `size` bytes are unpacked, whatever the data say of themselves
        if chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        elif chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD).stream_reader(packed).read(size + 1)
        elif chunk.compression == "":
            data = packed
        else:
            raise ValueError(f"it is compressed with {chunk.compression[:20]!r}; lz4, zstd and none can be read")
        if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
            raise ValueError(f"{len(data)} bytes instead of {size}, or its checksum is wrong")
    except (McapError, struct.error, ValueError, OverflowError, RuntimeError, EOFError, zstandard.ZstdError) as error:
        raise DataError(f"a chunk is damaged: {error}") from error
    return bytes(data)
