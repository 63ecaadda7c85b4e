"""What docs/protocol.md says in words of currents, times, numbers and the clock, held by server and driver.

firmware/tests/test_core.c holds the firmware to the same words, test_firmware.py to the same numbers of electrodes.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_protocol import DOC, PATTERN, answer

from ohmskin.device import Capabilities, Feature
from ohmskin.device.instrument import SharedInstrument
from ohmskin.device.messages import Ack, FrameData, Hello, Message, Scan, SetPattern
from ohmskin.device.protocol import PacketDecoder, encode
from ohmskin.device.session import Session
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.device.wire import WireDevice
from ohmskin.errors import DeviceLost
from ohmskin.scan import DrivePattern, Frame, FrameFlag, adjacent
from ohmskin.skin import Skin, VirtualSkin

SKIN = Skin.parse("[imaging]\nmesh_size = 20e-3\n[contact_layer]\ncolumns = 4\nrows = 4\npatch = 0.02")
UNMEASURED = Capabilities(
    "unmeasured", 16, 64, 1024, features=Feature.VIRTUAL, excitation=2e-3, settle_time=0.25, conversion_time=0.125
)
FRAMES = (  # those of the page
    Frame(PATTERN, np.array([0.25, -0.125, 0.5]), np.array([2e-3, 2e-3]), 10.0, 2**32 - 1),
    Frame(PATTERN, np.array([0.25, -0.125, 0.5]), np.array([2e-3, np.nan]), 10.002, 2**32),
)


def documented() -> list[tuple[int, float, bytes]]:
    """Number, time (s) and packet of the page's frames."""
    rows = re.findall(r"^\| (\d+) \| ([\d.]+) s \| 2 mA and [^|]+ \| `([0-9a-f]+)` \|$", DOC, re.M)
    return [(int(number), float(time), bytes.fromhex(packet)) for number, time, packet in rows]


def test_a_server_sends_the_documented_frames() -> None:
    left = list(FRAMES)
    instrument = SimpleNamespace(capabilities=UNMEASURED, scan=lambda _: left.pop(0))
    session = Session(SharedInstrument(instrument))
    assert answer(session, encode(SetPattern(0, PATTERN))) == Ack(PATTERN.digest)
    for sequence, (_, _, packet) in enumerate(documented(), 3):
        assert session.feed(encode(Scan(0, PATTERN.digest), sequence)) == packet
    assert not left


class Line:
    """A device at the other end of a driver's line, on a clock of its own; it says when requests came."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tell: Callable[[Message], Message | None]) -> None:
        self.now, self.came, self.byte_time = 0.0, list[tuple[float, int]](), 0.0
        self._tell, self._replies = tell, list[bytes]()
        monkeypatch.setattr("ohmskin.device.wire.open_transport", lambda _: self)
        monkeypatch.setattr("ohmskin.device.wire.time", SimpleNamespace(monotonic=lambda: self.now))

    def write(self, data: bytes) -> None:
        self.came.append((self.now, len(data)))
        for packet in PacketDecoder().feed(data):
            if reply := self._tell(packet.message):
                self._replies.append(encode(reply, packet.sequence))

    def read(self, timeout: float) -> bytes:
        self.now += 0.0 if self._replies else max(timeout, 1e-6)
        return self._replies.pop(0) if self._replies else b""

    def close(self) -> None:
        pass


def test_a_driver_takes_the_documented_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    told = [PacketDecoder().feed(packet)[0].message for _, _, packet in documented()]

    def tell(request: Message) -> Message:
        if request == Hello():
            return UNMEASURED
        return Ack(PATTERN.digest) if isinstance(request, SetPattern) else told.pop(0)

    Line(monkeypatch, tell)
    with WireDevice("tcp://x:1") as device:
        for frame, (number, time, _) in zip(FRAMES, documented(), strict=True):
            got = device.scan(PATTERN)
            np.testing.assert_allclose(got.currents, frame.currents, rtol=1e-6)  # as they came: nothing is made up
            np.testing.assert_array_equal(got.voltages, frame.voltages)
            assert (got.sequence, got.time, got.flags) == (number, pytest.approx(time, abs=1e-9), FrameFlag(0))


@pytest.mark.parametrize(("settle", "late"), [(0.25, 0.5 + 3 * 0.125), (4.0, 5.0)])
def test_a_driver_asks_again_after_the_documented_wait(
    settle: float, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """n_inj settle_time + n_meas conversion_time twice, or once and 5 s, and 50 ms; then 1.5 times."""
    able = replace(UNMEASURED, settle_time=settle)
    line = Line(monkeypatch, lambda request: able if request == Hello() else None)
    with WireDevice("tcp://x:1") as device:
        line.came.clear()
        with pytest.raises(DeviceLost):
            device.scan(PATTERN, timeout=60.0)
    (first, size), *more = line.came  # this line takes no time
    own = 2 * settle + 3 * 0.125
    waits = np.diff([first, *(at for at, _ in more)])
    assert waits[0] == pytest.approx(own + late + 0.05, abs=1e-5)
    assert waits[1] == pytest.approx(1.5 * waits[0], abs=1e-5)
    assert {length for _, length in more} == {size}


def test_scans_take_no_longer_than_told() -> None:
    """The virtual skin converts all voltages of an injection at once and tells the time of each, which is more."""
    for skin in (SKIN, Skin.load("ktc2023")):
        instrument = VirtualInstrument(skin, seed=0, realtime=False)
        pattern, told = adjacent([range(len(skin.electrodes))]), instrument.capabilities
        longest = pattern.n_inj * told.settle_time + pattern.n_meas * told.conversion_time
        assert told.scan_time(pattern) == pytest.approx(longest)
        assert 0 < VirtualSkin(skin, 0).duration(pattern) <= longest


def test_electrodes_are_numbered_from_the_rim_inwards_in_whatever_order_they_are_listed() -> None:
    listed = SKIN.dump().replace('layout = "grid"', 'layout = "listed"')
    frames = list[FrameData]()
    drawn = np.random.default_rng(4).permuted(np.tile(np.arange(16), (12, 1)), axis=1)
    pattern = DrivePattern(drawn[:, :2], np.column_stack([np.arange(12), drawn[:, 2:4]]))
    for order in (np.arange(16), np.random.default_rng(3).permutation(16)):
        places = SKIN.electrodes.positions[order].round(12).tolist()
        skin = Skin.parse(listed.replace("\npositions = []", f"\npositions = {places}", 1))
        np.testing.assert_allclose(skin.electrodes.positions, SKIN.electrodes.positions, atol=1e-9)
        session = Session(SharedInstrument(VirtualInstrument(skin, seed=0, realtime=False)))
        answer(session, encode(SetPattern(0, pattern)))
        frame = answer(session, encode(Scan(0, pattern.digest)))
        assert isinstance(frame, FrameData)
        frames.append(frame)
    noise = 10 * SKIN.converter.noise
    np.testing.assert_allclose(frames[1].voltages, frames[0].voltages, atol=noise)
    model = SKIN.transfer_model()
    modelled = np.asarray(model.voltages(pattern, np.asarray(frames[0].currents, float)))
    assert np.abs(frames[0].voltages - modelled).max() < 0.1 * np.abs(modelled).max()
    other = model.voltages(replace(pattern, injections=15 - pattern.injections), frames[0].currents)
    assert np.abs(frames[0].voltages - other).max() > 0.5 * np.abs(modelled).max()


def test_number_and_clock_go_on_through_sessions_and_connections() -> None:
    instrument = SharedInstrument(VirtualInstrument(SKIN, seed=0, realtime=False))
    one, other = Session(instrument), Session(instrument)
    frames = []
    for session in (one, one, other, one):
        assert isinstance(answer(session, encode(Hello())), Capabilities)
        answer(session, encode(SetPattern(0, PATTERN)))
        frame = answer(session, encode(Scan(0, PATTERN.digest)))
        assert isinstance(frame, FrameData)
        frames.append(frame)
    assert [frame.number for frame in frames] == [1, 2, 3, 4]
    assert [FrameFlag.FIRST in FrameFlag(frame.flags) for frame in frames] == [True, False, False, False]
    assert (np.diff([frame.time for frame in frames]) > 0).all()
