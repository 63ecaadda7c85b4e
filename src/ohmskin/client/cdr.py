"""CDR, the encoding of ROS 2 messages: little-endian, every number aligned to its own size (OMG DDS-XTypes, CDR 1)."""

import struct
from typing import Any

from ohmskin.errors import DataError

_HEADER = b"\0\1\0\0"  # little-endian, no options; alignment counts from behind it
_SIZES = {"b": 1, "B": 1, "?": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "q": 8, "Q": 8, "d": 8}


class CdrEncoder:
    """Writes one message, field by field in the order of its definition."""

    def __init__(self) -> None:
        self._data = bytearray(_HEADER)

    def put(self, kinds: str, *values: float) -> "CdrEncoder":
        """Numbers, one `struct` letter for each."""
        for kind, value in zip(kinds, values, strict=True):
            self._align(_SIZES[kind])
            self._data += struct.pack("<" + kind, value)
        return self

    def stamp(self, nanoseconds: int) -> "CdrEncoder":
        """`builtin_interfaces/msg/Time` of ns since 1970."""
        return self.put("iI", *divmod(nanoseconds, 10**9))

    def text(self, value: str) -> "CdrEncoder":
        """A string; a NUL, which would end it early for a reader in C, becomes a blank."""
        encoded = value.replace("\0", " ").encode(errors="replace") + b"\0"
        self.put("I", len(encoded))
        self._data += encoded
        return self

    def array(self, values: Any) -> "CdrEncoder":
        """A sequence of numbers from a NumPy array, of its own type."""
        self.put("I", values.size)
        if values.size:
            self._align(values.dtype.itemsize)
            self._data += values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()
        return self

    def done(self) -> bytes:
        """The message."""
        return bytes(self._data)

    def _align(self, size: int) -> None:
        self._data += b"\0" * (-(len(self._data) - len(_HEADER)) % size)


class CdrDecoder:
    """Reads one message, field by field; no length in it is believed before the bytes are counted.

    Raises:
        DataError: If the message is not little-endian CDR, or ends early.
    """

    def __init__(self, data: bytes) -> None:
        if data[:2] != _HEADER[:2] or len(data) < len(_HEADER):
            raise DataError("a message is not plain little-endian CDR")
        self._data, self._at = memoryview(data), len(_HEADER)

    def take(self, kinds: str) -> tuple[int | float, ...]:
        """Numbers, one `struct` letter for each."""
        values = []
        for kind in kinds:
            self._align(_SIZES[kind])
            values.append(struct.unpack("<" + kind, self._bytes(_SIZES[kind]))[0])
        return tuple(values)

    def stamp(self) -> int:
        """`builtin_interfaces/msg/Time` as ns since 1970."""
        seconds, nanoseconds = self.take("iI")
        return int(seconds) * 10**9 + int(nanoseconds)

    def text(self) -> str:
        """A string."""
        return bytes(self._bytes(int(self.take("I")[0]))).rstrip(b"\0").decode(errors="replace")

    def block(self, size: int) -> memoryview:
        """The bytes of a sequence of numbers of so many bytes each."""
        if count := int(self.take("I")[0]):
            self._align(size)
        return self._bytes(count * size)

    def count(self, smallest: int) -> int:
        """The length of a sequence whose entries take `smallest` bytes at least."""
        count = int(self.take("I")[0])
        if count * smallest > len(self._data) - self._at:
            raise DataError(f"a message says it has {count} entries, which do not fit into its {len(self._data)} bytes")
        return count

    @property
    def ended(self) -> bool:
        """Whether all has been read."""
        return self._at >= len(self._data)

    def _bytes(self, size: int) -> memoryview:
        if self._at + size > len(self._data):
            raise DataError(f"a message of {len(self._data)} bytes ends early: {size} more are due at byte {self._at}")
        self._at += size
        return self._data[self._at - size : self._at]

    def _align(self, size: int) -> None:
        self._at += -(self._at - len(_HEADER)) % size
