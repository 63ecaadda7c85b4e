"""The layout of every message on the wire. docs/protocol.md and the firmware's header are checked against this table.

All numbers are little-endian. A payload is a run of scalars, naturally aligned behind the 4-byte header, followed by
arrays whose lengths the scalars give, or by a text that fills the rest.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from ohmskin.errors import ProtocolError

VERSION = 1
MAX_PACKET = 65536  # bytes on the wire, without the delimiter
HEADER = struct.Struct("<BBH")  # protocol version, kind, sequence: the same in every protocol version
CHECKSUM = struct.Struct("<I")  # CRC-32 (zlib) of header and payload: the same in every protocol version


class MessageKind(IntEnum):
    """What a message is. Requests are below 0x80, replies above."""

    HELLO = 0x01
    PATTERN = 0x02
    SCAN = 0x03
    PRESS = 0x04
    CAPABILITIES = 0x81
    ACK = 0x82
    FRAME = 0x83
    ERROR = 0xFF


_CODES = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "f32": "f"}  # for struct and NumPy
_TOKEN = re.compile(r"(?P<name>\w+):(?P<kind>\w+?)(?:<=(?P<limit>\d+)|\[(?P<count>\w+)\](?:\[(?P<width>\d+)\])?)?")


@dataclass(frozen=True)
class PacketField:
    """One scalar, one array of `count` (the name of a scalar) rows of `width`, or one text of at most `limit` bytes."""

    name: str
    kind: str
    count: str = ""
    width: int = 1
    limit: int = 0

    @cached_property
    def size(self) -> int:
        """Bytes of a scalar or of one row of an array."""
        return self.width * self.dtype.itemsize

    @cached_property
    def dtype(self) -> np.dtype:
        """How NumPy stores one number."""
        return np.dtype("<" + _CODES[self.kind])

    def __str__(self) -> str:
        if self.limit:
            return f"{self.kind}<={self.limit}"
        return self.kind + (f"[{self.count}]" if self.count else "") + (f"[{self.width}]" if self.width > 1 else "")


class PacketLayout:
    """Packs and unpacks one kind of payload.

    Args:
        text: Fields such as `n:u16 rows:f32[n][2] name:text<=32`, scalars first.

    Raises:
        ProtocolError: If a field is malformed.
    """

    def __init__(self, text: str) -> None:
        fields = []
        for token in text.split():
            match = _TOKEN.fullmatch(token)
            if match is None:
                raise ProtocolError(f"layout {token!r}; need name:kind, name:kind[count][width] or name:text<=bytes")
            width, limit = int(match["width"] or 1), int(match["limit"] or 0)
            fields.append(PacketField(match["name"], match["kind"], match["count"] or "", width, limit))
        self.scalars = tuple(field for field in fields if not field.count and not field.limit)
        self.tail = tuple(fields[len(self.scalars) :])
        self._names = [field.name for field in self.scalars]
        self._counts = {field.count: field.name for field in self.tail if field.count}
        self._struct = struct.Struct("<" + "".join(_CODES[field.kind] for field in self.scalars))

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """The payload that carries `values`; counts are those of the arrays.

        Raises:
            ProtocolError: If a value does not fit its field.
        """
        values = {**values, **{count: len(values[name]) for count, name in self._counts.items()}}
        try:
            parts = [self._struct.pack(*[values[name] for name in self._names])]
        except (struct.error, OverflowError) as error:
            given = {field.name: values[field.name] for field in self.scalars}
            wanted = ", ".join(f"{field.name} {field.kind}" for field in self.scalars)
            raise ProtocolError(f"{given} does not fit {wanted}: {error}") from error
        for field in self.tail:
            value = values[field.name]
            if field.limit:
                # A text is cut between characters, never inside one.
                parts.append(value.encode()[: field.limit].decode(errors="ignore").encode())
                continue
            array = np.asarray(value)
            integers = field.kind != "f32" and array.size > 0
            if integers and not 0 <= array.min() <= array.max() <= np.iinfo(field.dtype).max:
                span = f"{array.min()} to {array.max()}"
                raise ProtocolError(f"{field.name} reach from {span}; {field.kind} is all the wire carries")
            with np.errstate(over="ignore"):  # a voltage beyond f32 arrives as inf: clipped
                parts.append(array.astype(field.dtype).tobytes())
        return b"".join(parts)

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """The values that `payload` carries, without the counts.

        Raises:
            ProtocolError: If its length does not fit the layout.
        """
        offset = self._struct.size
        if len(payload) < offset:
            raise ProtocolError(f"payload has {len(payload)} bytes; need at least {offset}")
        values: dict[str, Any] = dict(zip(self._names, self._struct.unpack_from(payload), strict=True))
        for field in self.tail:
            if field.limit:
                if len(payload) - offset > field.limit:
                    raise ProtocolError(f"text has {len(payload) - offset} bytes; at most {field.limit}")
                text = payload[offset:].decode(errors="replace").replace("\ufffd", "?")  # never more bytes than came
                return {**values, field.name: text}
            count = values.pop(field.count)
            end = offset + count * field.size
            if len(payload) < end:
                raise ProtocolError(f"payload has {len(payload)} bytes; {field.count} = {count} needs {end}")
            array = np.frombuffer(payload[offset:end], field.dtype)
            values[field.name] = array.reshape(-1, field.width) if field.width > 1 else array
            offset = end
        if len(payload) != offset:
            raise ProtocolError(f"payload has {len(payload)} bytes; need {offset}")
        return values


LAYOUTS = {
    MessageKind.HELLO: PacketLayout(""),
    MessageKind.PATTERN: PacketLayout(
        "slot:u16 n_inj:u16 n_meas:u16 injections:u16[n_inj][2] measurements:u16[n_meas][3]"
    ),
    MessageKind.SCAN: PacketLayout("digest:u32 slot:u16"),
    MessageKind.PRESS: PacketLayout("x:f32 y:f32 radius:f32 pressure:f32 number:u16"),
    MessageKind.CAPABILITIES: PacketLayout(
        "serial:u32 boot:u32 features:u32 excitation:f32 full_scale:f32 settle_time:f32 conversion_time:f32 "
        "n_electrodes:u16 max_injections:u16 max_measurements:u16 pattern_slots:u8 "
        "firmware_major:u8 firmware_minor:u8 firmware_patch:u8 name:text<=32"
    ),
    MessageKind.ACK: PacketLayout("value:u32"),
    MessageKind.FRAME: PacketLayout(
        "digest:u32 number:u32 time:u64 flags:u32 n_inj:u16 n_meas:u16 currents:f32[n_inj] voltages:f32[n_meas]"
    ),
    MessageKind.ERROR: PacketLayout("code:u16 text:text<=120"),
}
