"""Bytes to messages and back: framing, checksum, resynchronisation.

No input or output; docs/protocol.md describes it all.
"""

import zlib
from dataclasses import dataclass

from cobs import cobs

from ohmskin.device.layout import CHECKSUM, HEADER, LAYOUTS, MAX_PACKET, VERSION, MessageKind
from ohmskin.device.messages import Message, from_fields, kind_of, to_fields
from ohmskin.errors import OhmskinError, ProtocolError

DELIMITER = b"\0"


@dataclass(frozen=True)
class Unreadable:
    """A packet that arrived intact and yet is no valid message of this protocol version.

    Args:
        version: The sender's protocol version.
        kind: The number of its kind.
        reason: What is wrong with it.
    """

    version: int
    kind: int
    reason: str


@dataclass(frozen=True)
class Packet:
    """A message with the number of the request that it is or answers."""

    sequence: int
    message: Message | Unreadable


def encode(message: Message, sequence: int = 0) -> bytes:
    """The packet of one message, delimiter included.

    Raises:
        ProtocolError: If a value does not fit the wire.
    """
    kind = kind_of(message)
    packet = sealed(VERSION, kind, sequence & 0xFFFF, LAYOUTS[kind].pack(to_fields(message)))
    if len(packet) > MAX_PACKET + len(DELIMITER):
        raise ProtocolError(f"a {kind.name} packet of {len(packet) - 1} bytes; at most {MAX_PACKET}; split the pattern")
    return packet


def sealed(version: int, kind: int, sequence: int, payload: bytes) -> bytes:
    """The packet, delimiter included, around a payload, whatever it is."""
    body = HEADER.pack(version, kind, sequence) + payload
    return bytes(cobs.encode(body + CHECKSUM.pack(zlib.crc32(body)))) + DELIMITER


@dataclass
class Tally:
    """What a decoder has seen, in packets."""

    good: int = 0
    bad_cobs: int = 0
    bad_crc: int = 0
    overlong: int = 0
    unknown: int = 0  # intact, but no message of this protocol version

    @property
    def damaged(self) -> int:
        """Packets that were thrown away."""
        return self.bad_cobs + self.bad_crc + self.overlong


class PacketDecoder:
    """Finds packets in a stream of bytes. Nothing that arrives makes it raise."""

    def __init__(self) -> None:
        self.tally = Tally()
        self._rest = bytearray()
        self._skipping = False  # inside a packet that grew too long; the next delimiter ends it

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that `data` completes, in order."""
        packets = []
        *ends, rest = data.split(DELIMITER)
        for end in ends:
            self._collect(end)
            if self._rest and (packet := self._open(bytes(self._rest))) is not None:
                packets.append(packet)
            self._rest.clear()
            self._skipping = False
        self._collect(rest)
        return packets

    def _collect(self, data: bytes) -> None:
        if self._skipping:
            return
        self._rest += data
        if len(self._rest) > MAX_PACKET:
            self._rest.clear()
            self._skipping = True
            self.tally.overlong += 1

    def _open(self, stuffed: bytes) -> Packet | None:
        try:
            packet = cobs.decode(stuffed)
        except cobs.DecodeError:
            self.tally.bad_cobs += 1
            return None
        body = packet[: -CHECKSUM.size]
        if len(body) < HEADER.size or CHECKSUM.unpack(packet[-CHECKSUM.size :])[0] != zlib.crc32(body):
            self.tally.bad_crc += 1
            return None
        version, kind, sequence = HEADER.unpack_from(body)
        try:
            message = _read(version, kind, body[HEADER.size :])
        except OhmskinError as error:
            self.tally.unknown += 1
            return Packet(sequence, Unreadable(version, kind, str(error)))
        self.tally.good += 1
        return Packet(sequence, message)


def _read(version: int, kind: int, payload: bytes) -> Message:
    if version != VERSION:
        raise ProtocolError(f"protocol version {version}; this side speaks {VERSION}")
    if kind not in LAYOUTS:
        raise ProtocolError(
            f"message kind 0x{kind:02x} is unknown; known are {', '.join(f'0x{k:02x}' for k in MessageKind)}"
        )
    return from_fields(MessageKind(kind), LAYOUTS[MessageKind(kind)].unpack(payload))
