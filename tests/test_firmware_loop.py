"""The real firmware in the loop: host, firmware in QEMU, physics twin."""

import random
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_process import all_gone, children
from test_driver import line
from test_firmware import FIRMWARE, build

from ohmskin.arrays import Ints
from ohmskin.cli.press import press as press_command
from ohmskin.device import connect
from ohmskin.device.analogue import AnalogueSide
from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.firmware import EmulatedBoard
from ohmskin.device.messages import Ack, FrameData, Hello, Refusal, Scan, SetPattern
from ohmskin.device.protocol import PacketDecoder, encode
from ohmskin.device.transport import open_transport
from ohmskin.device.wire import WireDevice
from ohmskin.drive import complete_pattern
from ohmskin.engine import Engine, Touch
from ohmskin.errors import DeviceError, DeviceLost, DeviceRefused, SkinError
from ohmskin.scan import DrivePattern, FrameFlag, adjacent
from ohmskin.skin import Skin, VirtualSkin

SMALL = DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3], [0, 3, 4]]))
PLACES = [(0.05, 0.12), (0.1, 0.1), (0.155, 0.105), (0.12, 0.06), (0.03, 0.03)]
SESSION = 30.0  # s that the session is touched at one place after the other
BAUD = 921600


def arm(target: str) -> Path:
    """The firmware, built for a target."""
    return build(f"build/ohmskin-{target}.elf")


@pytest.fixture(scope="module")
def image() -> Path:
    return arm("qemu")


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin.load("paper")


@pytest.fixture(scope="module")
def quiet_skin(skin: Skin) -> Skin:
    """The same without noise."""
    return replace(skin, converter=replace(skin.converter, noise=0.0))


@contextmanager
def wired(board: EmulatedBoard) -> Iterator[WireDevice]:
    with connect(board.url) as device:
        assert isinstance(device, WireDevice)
        yield device


@pytest.mark.parametrize("target", ["f107", "qemu"])
def test_both_targets_fit_their_memory(target: str) -> None:
    arm(target)
    told = subprocess.run(["make", "-C", FIRMWARE, target], capture_output=True, text=True, check=True)
    found = re.search(r"flash (\d+) of (\d+), RAM (\d+) of (\d+)", told.stdout)
    assert found, told.stdout
    flash, flash_size, ram, ram_size = map(int, found.groups())
    assert 0 < flash <= flash_size
    assert 0 < ram <= ram_size


def test_the_analogue_side_has_the_codes_of_the_virtual_skin(quiet_skin: Skin) -> None:
    pattern = adjacent(quiet_skin.electrodes.rings)
    virtual, analogue = VirtualSkin(quiet_skin, 0), AnalogueSide(quiet_skin, 0)
    about, settle = analogue.describe(), 1e6 * quiet_skin.converter.settle
    for pressure in (0.0, 20e3):
        virtual.press(1, 0.06, 0.09, 8e-3, pressure)
        analogue.press(1, 0.06, 0.09, 8e-3, pressure)
        frame = virtual.scan(pattern)
        for k, (source, sink) in enumerate(pattern.injections):
            mine = pattern.measurements[:, 0] == k
            current, codes, limited = analogue.sample(source, sink, settle, pattern.measurements[mine, 1:])
            assert not limited
            np.testing.assert_allclose(
                (codes - about["volts_zero"]) * about["volts_per_code"], frame.voltages[mine], atol=1e-9
            )
            np.testing.assert_allclose(
                (current - about["amperes_zero"]) * about["amperes_per_code"], frame.currents[k], atol=1e-9
            )


def test_the_analogue_side_settles_as_long_as_it_is_given(quiet_skin: Skin) -> None:
    analogue, pair = AnalogueSide(quiet_skin, 0), np.array([[2, 3]])
    zero = analogue.describe()["volts_zero"]
    volts = [analogue.sample(0, 1, elapsed, pair)[1][0] - zero for elapsed in (0, 8, 1000)]
    assert volts[0] == 0
    assert volts[1] / volts[2] == pytest.approx(1 - np.exp(-1), abs=0.01)
    assert analogue.sample(1, 0, 0, pair)[1][0] - zero == volts[2]  # a new injection begins where the last one ended
    assert analogue.sample(1, 0, 1000, pair)[1][0] - zero == pytest.approx(-volts[2], abs=1)


def test_the_analogue_side_clips_as_a_converter_does(quiet_skin: Skin) -> None:
    narrow = replace(quiet_skin, converter=replace(quiet_skin.converter, full_scale=0.5, bits=12))
    analogue = AnalogueSide(narrow, 0)
    current, codes, _ = analogue.sample(0, 1, 1000, np.array([[0, 1], [1, 0], [8, 9]]))
    assert codes.tolist()[:2] == [4095, 0]
    assert 0 < codes[2] < 4095
    assert 2048 < current < 4095
    with pytest.raises(SkinError, match="at most 16"):
        AnalogueSide(replace(quiet_skin, converter=replace(quiet_skin.converter, bits=24)))


def test_frames_are_those_of_the_twin_and_say_how_fast(
    image: Path, quiet_skin: Skin, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sample, waited = AnalogueSide.sample, []

    def sample_and_note(
        self: AnalogueSide, source: int, sink: int, elapsed: float, pairs: Ints
    ) -> tuple[int, Ints, bool]:
        waited.append(elapsed)
        return sample(self, source, sink, elapsed, pairs)

    monkeypatch.setattr(AnalogueSide, "sample", sample_and_note)
    pattern = adjacent([quiet_skin.electrodes.rings[0]])
    expected = VirtualSkin(quiet_skin, 0).scan(pattern)
    step = quiet_skin.converter.full_scale / 2**15
    with EmulatedBoard(quiet_skin, image, seed=1) as board, wired(board) as device:
        able = device.capabilities
        measured = Feature.CURRENT_MEASURED | Feature.DRIVEN_MEASURED
        assert able.features == Feature.VIRTUAL | Feature.VOLTAGE_SOURCE | measured
        assert (able.name, able.n_electrodes, able.full_scale) == ("firmware, paper", 16, 5.0)
        first = device.scan(pattern)
        assert first.flags & FrameFlag.FIRST
        before, start = replace(device.link), time.monotonic()
        frames = [device.scan(pattern) for _ in range(100)]
        took = time.monotonic() - start
        bits = 10 * (device.link.bytes_in - before.bytes_in + device.link.bytes_out - before.bytes_out) / 100
        for frame in frames:  # the firmware waits a little longer than settle_time, never less
            np.testing.assert_allclose(frame.voltages, expected.voltages, atol=1.01 * step)
            np.testing.assert_allclose(frame.currents, expected.currents, rtol=1e-3)
        assert [frame.sequence for frame in frames] == list(range(first.sequence + 1, first.sequence + 101))
        assert frames[-1].time - first.time == pytest.approx(took, rel=0.2)  # the firmware's clock loses nothing
        assert min(waited) >= 100
        assert np.median(waited) < 10_000
        assert (device.link.damaged, device.link.resets) == (0, 0)
    assert bits == pytest.approx(5300, abs=30)  # docs/firmware.md does this sum
    with capsys.disabled():
        most = f"{bits:.0f} bits a frame, so at most {BAUD / bits:.0f} at {BAUD} baud"
        print(f"\nfirmware in QEMU: {100 / took:.0f} frames/s; {most}")


def test_averages_lower_the_noise(image: Path, skin: Skin) -> None:
    spread = {}
    for averages in (1, 16):
        with EmulatedBoard(skin, image, seed=2, averages=averages) as board, wired(board) as device:
            spread[averages] = np.std([device.scan(SMALL).voltages for _ in range(60)], axis=0).mean()
    assert spread[1] == pytest.approx(skin.converter.noise, rel=0.25)
    assert 0.18 < spread[16] / spread[1] < 0.35


@contextmanager
def serving(*arguments: str) -> Iterator[tuple[str, str, "subprocess.Popen[str]"]]:
    """The two addresses that `ohmskin serve-firmware` prints, and its process, which must end cleanly when asked."""
    command = [sys.executable, "-m", "ohmskin", "serve-firmware", "--port", "0", "--press-port", "0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        found = [re.search(r"tcp://\S+", process.stdout.readline()) for _ in range(2)]
        assert found[0]
        assert found[1]
        yield found[0][0], found[1][0], process
        if process.poll() is None:
            process.terminate()
            assert process.wait(120) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def feel(engine: Engine, cycles: int) -> Touch:
    touch = None
    for _ in range(cycles):
        touch = engine.step()
    assert touch is not None
    return touch


def test_a_session_finds_every_place_and_nothing_else(image: Path, skin: Skin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.engine.quiet._REPEATS", 6)
    with EmulatedBoard(skin, image, seed=3) as board, Engine(lambda: connect(board.url), skin, "12B") as engine:
        device = engine.device
        assert isinstance(device, WireDevice)
        greeting = device.link.retries  # the first HELLO may come while the firmware is still busy
        engine.calibrate()
        assert all(not feel(engine, 1).contacts for _ in range(100))
        end, rounds = time.monotonic() + SESSION, 0
        while rounds == 0 or time.monotonic() < end:
            for at in PLACES:
                engine.set_mode("16O" if rounds == 0 else "12B")
                engine.press(1, at, 8e-3, 20e3)
                touch = feel(engine, 8)
                (contact,) = touch.contacts
                assert np.hypot(*np.subtract(contact.position, at)) < 12e-3, f"{touch.mode.name} at {at}: {contact}"
            rounds += 1
        engine.press(1, at, 8e-3, 0.0)
        feel(engine, 8)
        assert all(not feel(engine, 1).contacts for _ in range(50))
        with connect(board.press_url) as fingers:  # what `ohmskin press` does beside it
            fingers.press(1, PLACES[0], 8e-3, 20e3)
            (contact,) = feel(engine, 8).contacts
            assert np.hypot(*np.subtract(contact.position, PLACES[0])) < 12e-3
        feel(engine, 2)
        assert (device.link.damaged, device.link.resets) == (0, 0)
        # On a busy computer replies may come late: what was asked twice was then answered twice, and nothing was lost.
        assert device.link.retries - device.link.dropped <= greeting


def test_a_reset_in_mid_scan_is_made_good(image: Path, quiet_skin: Skin, monkeypatch: pytest.MonkeyPatch) -> None:
    pattern, samples = adjacent([quiet_skin.electrodes.rings[0]]), 0
    with EmulatedBoard(quiet_skin, image) as board, wired(board) as device:
        expected, boot = device.scan(pattern), device.capabilities.boot
        sample = AnalogueSide.sample

        def sample_and_reset(*args: object) -> object:
            nonlocal samples
            samples += 1
            if samples == 5:
                board.reset()
            return sample(*args)  # type: ignore[arg-type]

        monkeypatch.setattr(AnalogueSide, "sample", sample_and_reset)
        frame = device.scan(pattern)
        assert samples >= 5 + 12  # four and a lost one, then a whole scan, or a repeated one
        np.testing.assert_allclose(frame.voltages, expected.voltages, atol=3.1e-4)
        assert device.link.resets == 1
        assert device.capabilities.boot != boot
        assert frame.sequence < 5  # counted from the start anew
        np.testing.assert_allclose(device.scan(pattern).voltages, expected.voltages, atol=3.1e-4)


def test_a_late_sample_is_not_taken_for_the_next_one(
    image: Path, quiet_skin: Skin, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = DrivePattern(np.array([[5, 9]]), np.array([[0, 1, 7], [0, 7, 12]]))
    expected = VirtualSkin(quiet_skin, 0).scan(other)
    sample, stuck = AnalogueSide.sample, threading.Event()

    def sample_late(*args: object) -> object:
        if not stuck.is_set():
            stuck.set()
            time.sleep(3.0)
        return sample(*args)  # type: ignore[arg-type]

    with EmulatedBoard(quiet_skin, image) as board, wired(board) as device:
        monkeypatch.setattr(AnalogueSide, "sample", sample_late)
        with pytest.raises(DeviceRefused, match="the converter did not answer"):
            device.scan(SMALL, timeout=10)
        time.sleep(2.5)  # its answer comes now, when nobody waits for it
        np.testing.assert_allclose(device.scan(other).voltages, expected.voltages, atol=3.1e-4)


def test_a_bad_line_costs_retries_but_never_gives_wrong_data(image: Path, quiet_skin: Skin) -> None:
    dice = random.Random(1)

    def spoil(data: bytes, towards_host: bool) -> bytes:
        return bytes(dice.randrange(256) if dice.random() < 0.01 else byte for byte in data)

    expected = VirtualSkin(quiet_skin, 0).scan(SMALL)
    with EmulatedBoard(quiet_skin, image) as board, line(board.url, spoil) as url, connect(url, timeout=20) as device:
        for _ in range(60):
            np.testing.assert_allclose(device.scan(SMALL, timeout=20).voltages, expected.voltages, atol=3.1e-4)
        assert device.link.retries > 0
        assert device.link.damaged > 0


def test_one_pattern_and_scan_ahead_is_never_lost_and_more_do_no_harm(image: Path, skin: Skin) -> None:
    complete = complete_pattern(skin.electrodes)
    with EmulatedBoard(skin, image) as board:
        with wired(board) as device:
            able = device.capabilities
        first, second, *_ = complete.split(able.max_injections, able.max_measurements)
        assert second.n_meas > able.max_measurements - 13  # the largest that fit
        both = enumerate((first, second))
        pairs = [
            encode(SetPattern(slot, pattern), slot) + encode(Scan(slot, pattern.digest), 8 + slot)
            for slot, pattern in both
        ]
        with closing(open_transport(board.url)) as line_to:
            decoder = PacketDecoder()

            def replies(last: tuple[int, type] | None) -> list[tuple[int, type]]:
                """Number and kind of what comes, up to the last, or until nothing comes for a second."""
                came: list[tuple[int, type]] = []
                while last not in came and (data := line_to.read(1.0 if last is None else 20.0)):
                    came += [(packet.sequence, type(packet.message)) for packet in decoder.feed(data)]
                return came

            def greeted(number: int) -> bool:
                line_to.write(b"\0" + encode(Hello(), number))
                return (number, Capabilities) in replies((number, Capabilities))

            assert greeted(990)  # after all that is still to come of the connection above
            line_to.write(pairs[0] + pairs[1])
            assert replies((9, FrameData)) == [(0, Ack), (8, FrameData), (1, Ack), (9, FrameData)]
            line_to.write(6 * (pairs[0] + pairs[1]))  # more than any ring holds
            came = replies((8, FrameData)) + replies(None)  # the first scan is never lost, however slow the board
            assert {Ack, FrameData} <= {kind for _, kind in came} <= {Ack, FrameData, Refusal}
            assert greeted(991) or greeted(992)  # a held up emulator may still have a full ring the first time
            assert decoder.tally.damaged == 0


def test_a_press_off_the_sheet_is_refused_in_the_words_of_the_twin(image: Path, skin: Skin) -> None:
    with EmulatedBoard(skin, image) as board:
        with wired(board) as device, pytest.raises(DeviceRefused, match="off the sheet"):
            device.press(1, (0.3, 0.1), 8e-3, 20e3)
        with connect(board.press_url) as fingers:
            with pytest.raises(DeviceRefused, match="off the sheet"):
                fingers.press(1, (0.3, 0.1), 8e-3, 20e3)
            with pytest.raises(DeviceRefused, match="scan the firmware's own port"):
                fingers.scan(DrivePattern(np.array([[0, 1]]), np.array([[0, 2, 3]])))


def test_a_new_host_finds_the_skin_untouched(image: Path, quiet_skin: Skin) -> None:
    with EmulatedBoard(quiet_skin, image) as board:
        with wired(board) as device:
            before = device.scan(SMALL)
            device.press(1, (0.05, 0.02), 8e-3, 20e3)
            pressed = device.scan(SMALL)
        with wired(board) as device:
            after = device.scan(SMALL)
    assert np.abs(pressed.voltages - before.voltages).max() > 10 * 3.1e-4
    np.testing.assert_allclose(after.voltages, before.voltages, atol=3.1e-4)


def test_what_is_missing_is_named(skin: Skin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: "/bin/true")
    with pytest.raises(DeviceError, match="make -C firmware qemu"):
        EmulatedBoard(skin, tmp_path / "none.elf")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(DeviceError, match="apt-get install qemu-system-arm"):
        EmulatedBoard(skin, tmp_path / "none.elf")


def test_an_emulator_that_ends_is_told(skin: Skin, tmp_path: Path) -> None:
    broken = tmp_path / "broken.elf"
    broken.write_bytes(b"no firmware" * 20000)  # more than the flash
    with pytest.raises(DeviceLost, match=r"emulator exited: .*broken\.elf"):
        EmulatedBoard(skin, broken)


def test_the_command_serves_and_leaves_nothing_behind(image: Path) -> None:
    with serving("--image", str(image)) as (url, press_url, process):
        with connect(url) as device:
            before = device.scan(SMALL).voltages
            press_command(50.0, 20.0, seconds=0.1, device=press_url)
            np.testing.assert_allclose(device.scan(SMALL).voltages, before, atol=2e-3)
        family = children(process.pid)
        assert family
    assert all_gone(family)
    with serving("--image", str(image)) as (_, _, process):
        family = children(process.pid)
        process.kill()
        process.wait()
        assert all_gone(family)
