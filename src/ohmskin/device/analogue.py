"""The analogue side of the emulated firmware: multiplexers, source and converter as the physics twin would have them.

The firmware in QEMU has no analogue pins; its second UART stands for them. Each packet is COBS(kind, tag, payload) and
a zero byte; a reply has the request's tag and 0x80 more in its kind. The line is a pipe of the emulator and loses
nothing, so there is no checksum; a firmware that was reset in mid-packet begins with a zero byte, and by the tags
knows replies that came too late.
"""

import socket
import threading
import zlib
from enum import IntEnum
from typing import Any

import numpy as np
from cobs import cobs

from ohmskin.arrays import Floats, Ints
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.instrument import MOST_PRESSES
from ohmskin.device.layout import LAYOUTS as PROTOCOL
from ohmskin.device.layout import MessageKind as ProtocolKind
from ohmskin.device.layout import PacketLayout
from ohmskin.device.virtual import twin_capabilities
from ohmskin.errors import DeviceRefused, ProtocolError, SkinError
from ohmskin.scan import DrivePattern, Frame
from ohmskin.skin import Skin, VirtualSkin

REPLY = 0x80
_CONVERSION = 5e-3  # s: a conversion takes what the emulator takes; so much on a computer busy with other things
_CURRENT_LIMIT = 2  # as BOARD_CURRENT_LIMIT in the firmware's board.h
_FIRMWARE = MOST_PRESSES  # numbers of presses that come through the firmware begin here


class AnalogueKind(IntEnum):
    """What the firmware asks of its analogue side."""

    DESCRIBE = 1  # what are you?
    SAMPLE = 2  # connect source and sink, let `elapsed` microseconds pass, convert the current and each pair once
    PRESS = 3  # passed on from the host; an empty text means done
    LIFT = 4  # all that the firmware passed on


LAYOUTS = {
    AnalogueKind.DESCRIBE: (
        PacketLayout(""),
        PacketLayout(
            "serial:u32 boot:u32 features:u32 excitation:f32 full_scale:f32 settle_time:f32 conversion_time:f32 "
            "volts_per_code:f32 amperes_per_code:f32 volts_zero:u16 amperes_zero:u16 code_max:u16 averages:u16 "
            "electrodes:u16 name:text<=32"
        ),
    ),
    AnalogueKind.SAMPLE: (
        PacketLayout("elapsed:u16 source:u8 sink:u8 count:u8 pairs:u8[count][2]"),
        PacketLayout("current:u16 flags:u8 count:u8 codes:u16[count]"),
    ),
    AnalogueKind.PRESS: (PROTOCOL[ProtocolKind.PRESS], PacketLayout("text:text<=100")),
    AnalogueKind.LIFT: (PacketLayout(""), PacketLayout("")),
}


class AnalogueSide:
    """What the firmware would measure on a real skin, as codes of the converter.

    Unlike `VirtualSkin.scan` it lets the channels settle for as long as the firmware really waited. Touches from
    elsewhere reach it as an `Instrument`, which refuses to scan: that is the firmware's part.

    Args:
        skin: What to simulate.
        seed: Seed of the noise.
        averages: Samples that the firmware averages to one value.

    Raises:
        SkinError: If the skin has more electrodes or bits than the emulated board, or a number is out of range.
    """

    def __init__(self, skin: Skin, seed: int | None = None, averages: int = 1) -> None:
        if skin.converter.bits > 16:
            raise SkinError(f"converter.bits is {skin.converter.bits}; the emulated board's codes have at most 16")
        if len(skin.electrodes) > 256:
            raise SkinError(f"skin {skin.name!r} has {len(skin.electrodes)} electrodes; the emulated board takes 256")
        if not 1 <= averages <= 65535:
            raise SkinError(f"averages is {averages}; it must be 1..65535")
        self.skin = skin
        self.described = threading.Event()  # the firmware has asked and been told what it is connected to
        name = f"fingers on {skin.name}".encode()[:32].decode(errors="ignore")
        self.capabilities = Capabilities(name, len(skin.electrodes), 1, 1, 1, Feature.VIRTUAL)
        self._virtual = VirtualSkin(skin, seed)
        self._averages = averages
        self._random = np.random.default_rng(seed)
        self._resistance = self._virtual.sheet.untouched
        self._potentials = self._before = np.zeros(len(skin.electrodes))  # when sampled last, and when driven last
        self._driven, self._elapsed = (-1, -1), 0.0
        self._lock = threading.Lock()

    def scan(self, pattern: DrivePattern) -> Frame:
        raise DeviceRefused("this port takes presses only; scan the firmware's own port")

    def press(self, number: int, x: float, y: float, radius: float, pressure: float) -> None:
        with self._lock:
            down = self._virtual.presses
            if pressure > 0 and number not in down and len(down) >= MOST_PRESSES:
                raise DeviceRefused(f"{MOST_PRESSES} presses are down, which is the most; lift one first")
            try:
                self._virtual.press(number, x, y, radius, pressure)
            except SkinError as error:
                raise DeviceRefused(str(error)) from error
            self._resistance = self._virtual.sheet.transfer_resistance(self._virtual.presses.values())

    def sample(self, source: int, sink: int, elapsed: float, pairs: Ints) -> tuple[int, Ints, bool]:
        """Convert once.

        Args:
            source: Electrode at which the current enters the sheet.
            sink: Electrode at which it leaves.
            elapsed: Time since they were connected (us).
            pairs: (n, 2) plus and minus electrodes.

        Returns:
            Code of the current, codes (n,) of the voltages, and whether the source ran into its current limit.
        """
        excitation, converter, supply = self.skin.excitation, self.skin.converter, self.skin.source
        with self._lock:
            r = self._resistance
        drive = r[source] - r[sink]
        wanted = excitation.amplitude
        if supply is not None:
            wanted = supply.amplitude / (drive[source] - drive[sink] + supply.resistance)
        limited, current = wanted > excitation.current_limit, min(wanted, excitation.current_limit)
        if (source, sink) != self._driven or elapsed < self._elapsed:
            self._before = self._potentials
        self._driven, self._elapsed = (source, sink), elapsed
        left = np.exp(-elapsed * 1e-6 / converter.time_constant) if converter.time_constant > 0 else 0.0
        settled = drive * current
        self._potentials = settled + left * (self._before - settled)
        volts = np.append(self._potentials[pairs[:, 0]] - self._potentials[pairs[:, 1]], current * converter.shunt)
        codes = self._convert(volts + self._random.normal(0, converter.noise, len(volts)))
        return int(codes[-1]), codes[:-1], bool(limited)

    def _convert(self, volts: Floats) -> Ints:
        """Codes of the converter; beyond its range, the first or the last one."""
        codes = np.rint(volts / self._volts_per_code) + self._zero
        return codes.clip(0, 2 * self._zero - 1).astype(np.int64)

    @property
    def _zero(self) -> int:
        return 1 << (self.skin.converter.bits - 1)

    @property
    def _volts_per_code(self) -> float:
        return self.skin.converter.full_scale / self._zero

    def describe(self) -> dict[str, Any]:
        """The fields of the answer to DESCRIBE; another boot number each time."""
        return {
            **vars(twin_capabilities(self.skin, f"firmware, {self.skin.name}", _CONVERSION)),
            "serial": zlib.crc32(b"firmware of " + self.skin.dump().encode()),
            "volts_per_code": self._volts_per_code,
            "amperes_per_code": self._volts_per_code / self.skin.converter.shunt,
            "volts_zero": self._zero,
            "amperes_zero": self._zero,
            "code_max": 2 * self._zero - 1,
            "averages": self._averages,
            "electrodes": len(self.skin.electrodes),
        }

    def answer(self, packet: bytes) -> bytes:
        """The reply to one request, both without COBS.

        Raises:
            ProtocolError: If it cannot be read.
        """
        if len(packet) < 2 or packet[0] not in set(AnalogueKind):
            raise ProtocolError(f"no request of the firmware: {packet[:8].hex()}")
        kind = AnalogueKind(packet[0])
        ask, tell = LAYOUTS[kind]
        return bytes([kind | REPLY, packet[1]]) + tell.pack(self._obey(kind, ask.unpack(packet[2:])))

    def _obey(self, kind: AnalogueKind, asked: dict[str, Any]) -> dict[str, Any]:
        match kind:
            case AnalogueKind.DESCRIBE:
                return self.describe()
            case AnalogueKind.SAMPLE:
                count = len(self.skin.electrodes)
                if max(asked["source"], asked["sink"], asked["pairs"].max(initial=0)) >= count:
                    raise ProtocolError(f"the firmware names an electrode beyond {count - 1}")
                current, codes, limited = self.sample(*(asked[name] for name in ("source", "sink", "elapsed", "pairs")))
                return {"current": current, "flags": _CURRENT_LIMIT * limited, "codes": codes}
            case AnalogueKind.PRESS:
                try:
                    self.press(**asked | {"number": asked["number"] + _FIRMWARE})
                except DeviceRefused as error:
                    return {"text": str(error)}
                return {"text": ""}
            case AnalogueKind.LIFT:
                for number, press in self._virtual.presses.items():
                    if number >= _FIRMWARE:
                        self.press(number, *press.position, press.radius, 0.0)
                return {}

    def serve(self, line: socket.socket) -> None:
        """Answer the firmware until the line is closed."""
        rest = b""
        try:
            while data := line.recv(4096):
                *packets, rest = (rest + data).split(b"\0")
                for stuffed in filter(None, packets):
                    try:
                        reply = self.answer(cobs.decode(stuffed))
                    except (ProtocolError, cobs.DecodeError):
                        continue  # the end of what a reset cut off
                    line.sendall(cobs.encode(reply) + b"\0")
                    if reply[0] == AnalogueKind.DESCRIBE | REPLY:
                        self.described.set()
        except OSError:
            return  # the emulator has gone
