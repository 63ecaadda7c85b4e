"""The driver of everything that speaks the wire protocol of docs/protocol.md."""

import itertools
import logging
import random
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.driver import Device
from ohmskin.device.layout import VERSION
from ohmskin.device.messages import Ack, ErrorCode, FrameData, Hello, Message, Refusal, Scan, SetPattern
from ohmskin.device.press import PressCommand
from ohmskin.device.protocol import DELIMITER, Packet, PacketDecoder, Unreadable, encode
from ohmskin.device.transport import Transport, open_transport
from ohmskin.errors import DeviceLost, DeviceRefused, ProtocolError
from ohmskin.scan import DrivePattern, Frame

_LOG = logging.getLogger(__name__)
_GRACE = 0.05  # s beyond the device's own time before a request is sent again; USB adapters hold data back for 16 ms
_BACKOFF = 1.5  # each further wait is longer, so that a slow device is not buried in requests
_LATE = 5.0  # s beyond that at most, before which a device is given as long again as it says
_MOST_ATTEMPTS = 40
_PRESS_TIMEOUT = 10.0  # a press on all of a virtual skin takes seconds
_REPLIES: dict[type, type] = {Hello: Capabilities, SetPattern: Ack, Scan: FrameData, PressCommand: Ack}


@dataclass
class Link:
    """Counters of a connection since it was made.

    Args:
        requests: Requests sent.
        retries: Requests sent again.
        dropped: Replies that no request waited for: duplicates and late ones.
        damaged: Packets that failed framing or checksum.
        resets: How often the device had lost its patterns.
        bytes_in: Bytes received.
        bytes_out: Bytes sent.
    """

    requests: int = 0
    retries: int = 0
    dropped: int = 0
    damaged: int = 0
    resets: int = 0
    bytes_in: int = 0
    bytes_out: int = 0


class _ForgottenError(Exception):
    """The device does not have the pattern that it was given earlier."""


class WireDevice(Device):
    """A device behind TCP or a serial port.

    Lost requests and replies are sent again with the same number, so that a late reply still counts and its duplicate
    is dropped. A pattern is put into a slot of the device together with its first scan, in one round trip.

    Args:
        url: `tcp://host:port` or `serial:///dev/ttyACM0?baud=921600`.
        timeout: Longest time to wait for the device's greeting (s).

    Raises:
        DeviceLost: If nothing answers in time.
        ProtocolError: If the device speaks another protocol version.
    """

    def __init__(self, url: str, timeout: float = 3.0) -> None:
        self.link = Link()
        self._peer = url
        self._decoder = PacketDecoder()
        self._slots: OrderedDict[DrivePattern, int] = OrderedDict()  # least recently used first
        self._numbers = itertools.count(random.randrange(0x10000))  # replies meant for an earlier host match nothing
        self._transport: Transport = open_transport(url)
        try:
            self._transport.write(DELIMITER)  # ends whatever an earlier host left unfinished
            super().__init__(url, self._greet(timeout))
        except BaseException:
            self._transport.close()
            raise

    @property
    def dropped(self) -> int:
        return self.link.retries

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        deadline = time.monotonic() + timeout
        on_the_line = 4 * (pattern.n_inj + pattern.n_meas + 10) * self._transport.byte_time
        own_time = self.capabilities.scan_time(pattern) + on_the_line
        while True:
            known = pattern in self._slots
            slot = self._slots[pattern] if known else self._free_slot()
            scan = Scan(slot, pattern.digest)
            try:
                reply = self._ask([scan] if known else [SetPattern(slot, pattern), scan], deadline, own_time)
            except _ForgottenError:
                self._meet_again(deadline)
                continue
            assert isinstance(reply, FrameData)
            frame = reply.frame(pattern, Feature.AUXILIARY in self.capabilities.features)
            self._slots[pattern] = slot
            self._slots.move_to_end(pattern)
            return frame

    def _press(self, press: PressCommand) -> None:
        self._ask([press], time.monotonic() + _PRESS_TIMEOUT)

    def _close(self) -> None:
        self._transport.close()

    def _greet(self, timeout: float) -> Capabilities:
        self._slots.clear()
        reply = self._ask([Hello()], time.monotonic() + timeout)
        assert isinstance(reply, Capabilities)
        return reply

    def _meet_again(self, deadline: float) -> None:
        """Begin a new session with a device that has forgotten its patterns."""
        self.link.resets += 1
        _LOG.warning("%s has lost its patterns, probably by a reset; sending them again", self._peer)
        before, now = self.capabilities, self._greet(deadline - time.monotonic())
        if replace(now, boot=before.boot) != before:
            other = f"{now.name!r} instead of {before.name!r}"
            raise DeviceLost(f"another device answers at {self._peer}: {other}")
        self.capabilities = now

    def _free_slot(self) -> int:
        if len(self._slots) >= self.capabilities.pattern_slots:
            return self._slots.popitem(last=False)[1]
        return min(set(range(self.capabilities.pattern_slots)).difference(self._slots.values()))

    def _ask(self, requests: Sequence[Message], deadline: float, own_time: float = 0.0) -> Message:
        """Send requests in one go and return the reply to the last, which takes the device `own_time` seconds."""
        pending = {next(self._numbers) & 0xFFFF: request for request in requests}
        last = [*pending][-1]
        data = b"".join(encode(request, number) for number, request in pending.items())
        wait = own_time + min(own_time, _LATE) + len(data) * self._transport.byte_time + _GRACE
        start = next_try = time.monotonic()
        attempts, last_word = 0, ""
        reply: Message | None = None
        late = False
        deadline = max(deadline, start + wait)  # this host may have been suspended since it was set
        while not late and attempts < _MOST_ATTEMPTS:
            now = time.monotonic()
            late = now >= deadline  # then look once more: if this host was suspended, the reply is here already
            if now >= next_try and not late:
                self._send(data, len(requests), again=attempts > 0)
                attempts, next_try, wait = attempts + 1, now + wait, wait * _BACKOFF
            damaged = self.link.damaged
            for packet in self._receive(max(min(next_try, deadline) - now, 0.0)):
                request = pending.get(packet.sequence)
                match packet.message:
                    case _ if request is None:
                        self.link.dropped += 1
                    case Unreadable() as unreadable:
                        raise ProtocolError(self._complaint(unreadable))
                    case Refusal(code, text):
                        last_word = f" ; its last error was {text!r}"
                        if self._weigh(code, text, alone=len(requests) == 1):
                            next_try = now
                    case Ack(digest) if isinstance(request, SetPattern) and digest != request.pattern.digest:
                        raise ProtocolError(
                            f"{self._peer} gives the pattern the digest {digest:#010x}; it is "
                            f"{request.pattern.digest:#010x}; "
                            "its firmware computes the digest differently from docs/protocol.md"
                        )
                    case message if isinstance(message, _REPLIES[type(request)]):
                        del pending[packet.sequence]
                        reply = message if packet.sequence == last else reply
                    case message:
                        self.link.dropped += 1
                        last_word = f"; it answered {type(request).__name__} with {type(message).__name__}"
            if reply is not None:
                return reply
            if self.link.damaged > damaged:  # most probably that was the reply
                next_try = now
        tried = f"in {now - start:.2f} s and {attempts} attempts"
        raise DeviceLost(f"{self._peer} did not answer {tried}{last_word}; {self._hint()}")

    def _send(self, data: bytes, requests: int, again: bool) -> None:
        self._transport.write(data)
        self.link.bytes_out += len(data)
        if again:
            self.link.retries += requests
        else:
            self.link.requests += requests

    def _receive(self, timeout: float) -> list[Packet]:
        data = self._transport.read(timeout)
        packets = self._decoder.feed(data)
        self.link.bytes_in += len(data)
        self.link.damaged = self._decoder.tally.damaged
        return packets

    def _weigh(self, code: int, text: str, alone: bool) -> bool:
        """Whether to ask again at once after a refusal; raises if asking again is no use."""
        match code:
            case ErrorCode.BUSY:  # perhaps with an earlier copy of this very request; its reply may still come
                return False
            case ErrorCode.UNKNOWN_SLOT | ErrorCode.DIGEST_MISMATCH if alone:
                raise _ForgottenError
            case ErrorCode.UNKNOWN_SLOT | ErrorCode.DIGEST_MISMATCH:  # the upload that went before was lost
                return True
            case _:
                raise DeviceRefused(f"{self._peer} refused: {text or 'no reason given'} (code {code})")

    def _complaint(self, unreadable: Unreadable) -> str:
        if unreadable.version != VERSION:
            older = "the device's firmware" if unreadable.version < VERSION else "ohmskin on this host"
            return f"{self._peer} speaks protocol {unreadable.version}, this host {VERSION}; update {older}"
        return f"{self._peer} sent an invalid reply: {unreadable.reason}; check its firmware against docs/protocol.md"

    def _hint(self) -> str:
        if not self.link.bytes_in:
            return "no byte came back: check its power, and that this is the right port"
        if not self._decoder.tally.good:
            came = f"{self.link.bytes_in} bytes came, but no valid message"
            return f"{came}: check the baud rate, and that this is an ohmskin device"
        return "it answered before: check its power and plug"
