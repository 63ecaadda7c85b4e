"""The recording's format: independent readers find every field in it, cut and damaged files are read as far as they
go."""

import math
import struct
import tracemalloc
from contextlib import suppress
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recordings import SKIN, Bench, record_press, some_frames
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import ohmskin as ohm
import ohmskin.client
from ohmskin.client.cdr import CdrDecoder, CdrEncoder
from ohmskin.client.fields import as_json, columns, components, numbers
from ohmskin.client.fields import fields as contact_fields
from ohmskin.contacts import Contact
from ohmskin.errors import DataError, OhmskinError
from ohmskin.geometry import Raster
from ohmskin.importers import read_recording
from ohmskin.mcap import RecordingReader, Role, is_recording, recover
from ohmskin.mcap.container import LARGEST_RECORD, Container
from ohmskin.mcap.messages import (
    decode_frame,
    decode_pattern,
    decode_touch,
    encode_frame,
    encode_pattern,
    encode_touch,
)
from ohmskin.mcap.modes import decode_modes
from ohmskin.mcap.schemas import FRAME, IMAGE, PATTERN, TOPICS
from ohmskin.mcap.standard import decode_image, decode_log, encode_image, encode_log
from ohmskin.mcap.writer import RecordingWriter
from ohmskin.recording import Recorder
from ohmskin.recording.export import write_npz
from ohmskin.scan import DrivePattern, Frame, FrameFlag, adjacent


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[ohm.Touch]]:
    path = tmp_path_factory.mktemp("mcap") / "press.mcap"
    return path, record_press(path)


def write_frames(path: Path, frames: list[Frame], role: Role = Role.BASE, modes: str = "{}") -> None:
    """A recording of these frames, without a loop."""
    device = {
        "name": "none",
        "n_electrodes": "16",
        "max_injections": "256",
        "max_measurements": "4096",
        "features": "2",
    }
    device |= dict.fromkeys(("excitation", "full_scale", "settle_time", "conversion_time"), "0.0") | {"serial": "0"}
    writer = RecordingWriter(
        str(path), {"ohmskin": {"format": "1", "modes": modes}, "device": device}, {"skin.toml": SKIN.dump()}
    )
    stored = set()
    for number, frame in enumerate(frames):
        if frame.pattern not in stored:
            stored.add(frame.pattern)
            writer.add(PATTERN, 0, number, encode_pattern(frame.pattern))
        writer.add(FRAME, number, number, encode_frame(frame, number, 0.01 * number, role, "12B"))
    writer.close()


def same(a: Frame, b: Frame) -> bool:
    """Whether two frames are the same to the last bit, NaN included."""
    return (
        a.pattern == b.pattern
        and a.voltages.tobytes() == b.voltages.tobytes()
        and a.currents.tobytes() == b.currents.tobytes()
        and (a.time, a.sequence, a.flags) == (b.time, b.sequence, b.flags)
    )


def test_independent_readers_find_every_field(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, touches = recorded
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in TOPICS.values():
        own = {k: v for k, v in get_types_from_msg(definition, name).items() if "ohmskin" in k}
        store.register(own)
        for kind, fields in get_types_from_msg(
            definition, name
        ).items():  # the definitions in the file are the known ones
            assert store.fielddefs[kind][1] == fields[1], kind
    found: dict[str, list] = {topic: [] for topic in TOPICS}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.name, channel.message_encoding) == (TOPICS[channel.topic][0], "cdr")
            found[channel.topic].append((message, store.deserialize_cdr(message.data, schema.name)))
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(len(messages) for messages in found.values())
        attached = {a.name: a.data.decode() for a in reader.iter_attachments()}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert ohm.Skin.parse(attached["skin.toml"]) == SKIN
    assert metadata["ohmskin"]["ohmskin"] == ohm.__version__
    frames = {m.sequence: m for _, m in found["/ohmskin/frame"] if m.role != Role.QUIET}
    patterns = {m.digest: m for _, m in found["/ohmskin/pattern"]}
    cycles = [m for _, m in found["/ohmskin/touch"]]
    assert len(cycles) == len(touches)
    for cycle, touch in zip(cycles, touches, strict=True):
        assert (cycle.sequence, cycle.time, cycle.mode) == (touch.sequence, touch.time, touch.mode.name)
        for c, contact in zip(cycle.contacts, touch.contacts, strict=True):
            assert (c.id, c.x, c.y) == (contact.id, *contact.position)
            assert (c.extent, c.strength, c.confidence, c.peak) == (
                contact.extent,
                contact.strength,
                contact.confidence,
                contact.peak,
            )
        for number, frame in zip(cycle.frames, touch.percept.frames, strict=True):
            stored = frames[int(number)]
            assert (stored.time, stored.sequence, stored.flags) == (frame.time, frame.sequence, int(frame.flags))
            np.testing.assert_array_equal(stored.voltages, frame.voltages)
            np.testing.assert_array_equal(stored.currents, frame.currents)
            pattern = patterns[stored.pattern]
            np.testing.assert_array_equal(pattern.injections.reshape(-1, 2), frame.pattern.injections)
            np.testing.assert_array_equal(pattern.measurements.reshape(-1, 3), frame.pattern.measurements)
    assert any(cycle.contacts for cycle in cycles)
    raster = Raster(SKIN.mesh(), 64)
    images = found["/ohmskin/image"]
    assert len(images) == len(touches)  # recorded without a limit
    for message, image in images:
        values = raster(touches[message.sequence - 1].percept.image.values)
        assert (image.encoding, image.height, image.width, image.step) == ("32FC1", 64, 64, 256)
        np.testing.assert_array_equal(image.data.view("<f4").reshape(64, 64)[::-1], values.astype("f4"))
    x = float(metadata["raster"]["x0"]) + float(metadata["raster"]["pitch"]) * np.arange(64)
    np.testing.assert_allclose(x, raster.x, rtol=1e-12)
    for message, array in found["/ohmskin/markers"]:
        contacts = touches[message.sequence - 1].contacts
        assert [m.action for m in array.markers] == [3] + [0] * len(contacts)
        for marker, contact in zip(array.markers[1:], contacts, strict=True):
            assert (marker.pose.position.x, marker.pose.position.y) == contact.position
            assert math.pi * (marker.scale.x / 2) ** 2 == pytest.approx(contact.extent)
            assert (marker.header.frame_id, marker.id, marker.pose.orientation.w) == ("skin", contact.id, 1.0)
    health = found["/ohmskin/health"][0][1].status[0]
    assert {v.key for v in health.values} >= {"rate_Hz", "latency_p99_s", "noise_V", "dropped", "waiting"}


@given(
    st.lists(st.floats(width=64), min_size=108, max_size=108),
    st.integers(0, 2**64 - 1),
    st.floats(allow_nan=False),
    st.integers(0, 15),
    st.sampled_from(Role),
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20),
)
@settings(max_examples=100)
def test_frames_come_back_to_the_last_bit(
    voltages: list, sequence: int, at: float, flags: int, role: Role, mode: str
) -> None:
    pattern = ohm.adjacent([range(12)])
    frame = Frame(pattern, np.array(voltages), np.array(voltages[:12]), at, sequence, FrameFlag(flags))
    stamp = 1_700_000_000_123_456_789
    record = decode_frame(encode_frame(frame, stamp, 2.5, role, mode))
    assert same(record.frame(pattern), frame)
    assert (record.stamp, record.arrived, record.role, record.mode, record.pattern) == (
        stamp,
        2.5,
        role,
        mode,
        pattern.digest,
    )


def test_signalling_nans_are_nans_like_others() -> None:
    """Multiplied they would warn."""
    pattern = ohm.adjacent([range(12)])
    bits = 0x7FF4000000000000
    volts = np.full(pattern.n_meas, bits, np.uint64).view(float)
    frame = Frame(pattern, volts, volts[:12])
    read = decode_frame(encode_frame(frame, 0, 0.0, Role.BASE, ""))
    assert np.isnan(read.voltages * 2).all()
    assert np.isnan(read.currents * 2).all()
    image = encode_image(np.zeros((2, 2)), 5)
    single = np.full(4, 0x7FA00000, np.uint32).tobytes()
    assert np.isnan(decode_image(image[: -len(single)] + single)).all()


def test_other_messages_come_back() -> None:
    pattern = ohm.adjacent([range(16)])
    assert decode_pattern(encode_pattern(pattern)) == pattern
    contacts = (Contact((0.01, -0.02), 1e-4, -2e-4, 0.75, -0.5, 3), Contact((1.0, 2.0), 0.0, 1.0, 1.0, 2.0))
    touch = decode_touch(encode_touch(7, 1.5, 10**18 + 1, "16O", (1, 2**64 - 1), contacts))
    assert (touch.sequence, touch.time, touch.stamp, touch.mode) == (7, 1.5, 10**18 + 1, "16O")
    assert (touch.frames, touch.contacts) == ((1, 2**64 - 1), contacts)
    pixels = np.arange(12.0).reshape(3, 4)
    pixels[0, 0] = np.nan
    np.testing.assert_array_equal(decode_image(encode_image(pixels, 5)), pixels)
    assert decode_log(encode_log("Grüße\0!", 5)) == "Grüße !"


def test_cdr_aligns_as_ros_does() -> None:
    store = get_typestore(Stores.EMPTY)
    definition = "uint8 a\nfloat64 b\nstring c\nuint16[] d\nfloat64[] e\nbool f\nint32 g\n"
    store.register(get_types_from_msg(definition, "x/msg/Mixed"))
    for text in ("", "a", "abc", "abcd"):
        for count in (0, 1, 3):
            d, e = np.arange(count, dtype="u2"), np.arange(count, dtype="f8")
            ours = CdrEncoder().put("Bd", 7, 0.5).text(text).array(d).array(e).put("?i", True, -2).done()
            theirs = store.deserialize_cdr(ours, "x/msg/Mixed")
            assert (theirs.a, theirs.b, theirs.c, theirs.f, theirs.g) == (7, 0.5, text, True, -2)
            np.testing.assert_array_equal(theirs.d, d)
            np.testing.assert_array_equal(theirs.e, e)
            decoder = CdrDecoder(ours)
            assert (decoder.take("Bd"), decoder.text()) == ((7, 0.5), text)
            np.testing.assert_array_equal(np.frombuffer(decoder.block(2), "<u2"), d)
            np.testing.assert_array_equal(np.frombuffer(decoder.block(8), "<f8"), e)
            assert decoder.take("?i") == (True, -2)


def test_a_sequence_that_cannot_fit_is_refused_before_it_is_read() -> None:
    whole = CdrEncoder().put("I", 3).done() + bytes(24)
    assert CdrDecoder(whole).count(8) == 3
    with pytest.raises(DataError, match="it has 3 entries, which do not fit"):
        CdrDecoder(whole[:-1]).count(8)


def test_a_recording_reads_as_any_other(recorded: tuple[Path, list[ohm.Touch]]) -> None:
    path, touches = recorded
    recording = read_recording(path)
    assert is_recording(path)
    assert recording.notes == ()
    flown = [frame for touch in touches for frame in touch.percept.frames]
    assert len(recording.frames) == len(flown)
    assert all(same(a, b) for a, b in zip(recording.frames, flown, strict=True))
    assert len(recording.quiet) == 120  # 40 of each of three patterns that the others are a part of
    assert recording.reader is not None
    assert recording.reader.times[0] < 0 == recording.reader.times[len(recording.quiet)]
    recording.reader.close()
    with pytest.raises(DataError, match="holds its own patterns"):
        read_recording(path, reference=path)


def test_patterns_with_the_same_digest_are_told_apart(tmp_path: Path) -> None:
    one, other = ohm.adjacent([range(12)]), ohm.adjacent([range(12)])
    other = DrivePattern(other.injections[:, ::-1], other.measurements)
    object.__setattr__(other, "__dict__", other.__dict__ | {"digest": one.digest})  # a collision of the checksum
    frames = [
        Frame(p, np.full(p.n_meas, float(k)), np.ones(p.n_inj), 0.0, k) for k, p in enumerate([one, other, one, other])
    ]
    writer = RecordingWriter(str(tmp_path / "a.mcap"), {"ohmskin": {"format": "1"}}, {})
    for number, frame in enumerate(frames):
        writer.add(PATTERN, 0, number, encode_pattern(frame.pattern))
        writer.add(FRAME, number, number, encode_frame(frame, 0, 0.0, Role.BASE, ""))
    writer.close()
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert [reader.pattern(k) == one for k in range(4)] == [True, False, True, False]


@pytest.mark.parametrize("share", [0.15, 0.4, 0.7, 0.95, 0.999])
def test_a_cut_file_is_read_as_far_as_it_goes_and_mended(tmp_path: Path, share: float) -> None:
    whole, cut, frames = tmp_path / "whole.mcap", tmp_path / "cut.mcap", some_frames(200)
    write_frames(whole, frames)
    content = whole.read_bytes()
    cut.write_bytes(content[: int(share * len(content))])
    with RecordingReader(cut) as reader:
        count = len(reader.frames)
        assert all(same(reader.frame(k), frames[k]) for k in range(count))
        (note,) = reader.notes
        assert f"ohmskin recover {cut}" in note
    with Container(cut) as container:  # all whole chunks are there: at most the frames of one are missing
        list(container.messages())
        assert container.end <= cut.stat().st_size
    done = recover(cut)
    assert done.path == tmp_path / "cut.recovered.mcap"
    assert (done.frames, done.whole) == (count, False)
    assert cut.read_bytes() == content[: int(share * len(content))]
    with RecordingReader(done.path) as reader:
        assert reader.notes == ()
        assert reader.skin == SKIN.dump()
        assert all(same(reader.frame(k), frames[k]) for k in range(count))
    with done.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)  # by its index
        assert len(list(reader.iter_messages(topics=["/ohmskin/frame"]))) == count
    with pytest.raises(DataError, match="never overwritten"):
        recover(cut)


def test_a_damaged_chunk_costs_its_frames_and_no_more(tmp_path: Path) -> None:
    path, frames = tmp_path / "a.mcap", some_frames(100)
    write_frames(path, frames)
    content = bytearray(path.read_bytes())
    for at in (len(content) // 2, len(content) // 2 + 9):
        content[at] ^= 0xFF
    path.write_bytes(content)
    with RecordingReader(path) as reader:
        assert 90 <= len(reader.frames) < 100
        known = {frame.sequence: frame for frame in frames}
        assert all(same(frame, known[frame.sequence]) for frame in reader.select(Role.BASE))
        assert "damaged" in reader.notes[0]
    assert recover(path).damaged >= 1


def test_files_of_others_are_refused_kindly(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    writer = Writer(str(path), compression=CompressionType.ZSTD)
    writer.start()
    channel = writer.register_channel("/camera", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"uint8 a"))
    writer.add_message(channel, 1, b"\0\1\0\0\7", 2, 3)
    writer.finish()
    with pytest.raises(
        DataError, match=r"holds no frames of ohmskin; its topics are /camera.* patches BODY.toml --replay"
    ):
        RecordingReader(path)
    done = recover(path)
    assert done.messages == 1  # but mended it can be, zstd and all
    with Container(done.path) as container:
        ((_, _, message),) = container.messages()
    assert (message.log_time, message.publish_time, message.sequence, message.data) == (1, 2, 3, b"\0\1\0\0\7")
    write_frames(tmp_path / "new.mcap", some_frames(3))
    content = (tmp_path / "new.mcap").read_bytes()
    (tmp_path / "new.mcap").write_bytes(content.replace(b"format\1\0\0\0001", b"format\1\0\0\0009"))
    with pytest.raises(DataError, match="layout '9'; this version of ohmskin reads layout '1'"):
        RecordingReader(tmp_path / "new.mcap")


def chunk(compression: str, packed: bytes, size: int) -> bytes:
    """A chunk record that says it unpacks to `size` bytes."""
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 0, size, 0, len(name)) + name + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize("claim", [10, LARGEST_RECORD, 2**62])
@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_bomb_does_not_go_off(tmp_path: Path, compression: str, claim: int) -> None:
    import zstandard

    zeros = bytes(2**28)
    packed = lz4.frame.compress(zeros) if compression == "lz4" else zstandard.compress(zeros)
    del zeros
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + chunk(compression, packed, claim))
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match="no frames"):
            RecordingReader(path)
        assert tracemalloc.get_traced_memory()[1] < 3 * LARGEST_RECORD
    finally:
        tracemalloc.stop()


def test_a_file_of_ever_the_same_frames_is_refused_before_they_are_all_read(tmp_path: Path, small: bytes) -> None:
    """Thirty chunks of 16 MiB of the shortest messages there are, in 54 kB."""
    import zstandard

    message = struct.pack("<BQ", 5, 22) + struct.pack("<HIQQ", 1, 0, 0, 0)
    records = message * (LARGEST_RECORD // len(message))
    packed = chunk("zstd", zstandard.compress(records), len(records))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(small[:8] + 30 * packed)
    assert path.stat().st_size < 100_000
    with Container(path) as container, pytest.raises(DataError, match="unpacks to more than 256 times its size"):
        for _ in container.messages():
            pass
    assert container.end < path.stat().st_size / 5
    with pytest.raises(DataError, match="damaged, or malicious"):
        RecordingReader(path)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    write_frames(path, some_frames(6))
    return path.read_bytes()


@given(st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_hostile_file_gives_frames_or_one_clear_error(tmp_path: Path, small: bytes, data: st.DataObject) -> None:
    content = bytearray(small)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        match data.draw(st.sampled_from(["flip", "number", "cut", "double"])):
            case "flip":
                content[at] = data.draw(st.integers(0, 255))
            case "number":
                content[at : at + 8] = data.draw(st.sampled_from([b"\xff" * 8, b"\0" * 8, b"\0\0\0\0\0\0\0\x7f"]))
            case "cut":
                del content[at:]
            case "double":
                content[at:at] = content[at // 2 : at]
        if not content:
            break
    path = tmp_path / "hostile.mcap"
    path.write_bytes(content)
    try:
        with RecordingReader(path) as reader:
            for frame in reader.select(*Role):
                assert frame.voltages.shape == (frame.pattern.n_meas,)
            assert np.isfinite(reader.times).all()
        outcome = None
    except OhmskinError as error:
        outcome = error
    assert outcome is None or str(path) in str(outcome)


@given(st.sampled_from(list(TOPICS)), st.binary(max_size=200))
@example("/ohmskin/touch", b"\0\1\0\0" + bytes(24) + b"\1\0\0\0\0\0\0\0\0\0\0\0\xff\xff\xff\xff")
@example("/ohmskin/image", b"\0\1\0\0" + b"\xff" * 60)
@settings(max_examples=300)
def test_hostile_messages_are_data_errors(topic: str, content: bytes) -> None:
    decode = {
        "/ohmskin/pattern": decode_pattern,
        "/ohmskin/frame": decode_frame,
        "/ohmskin/touch": decode_touch,
        "/ohmskin/image": decode_image,
    }.get(topic, decode_log)
    for bytes_ in (content, b"\0\1\0\0" + content):
        with suppress(DataError):  # any other error fails
            decode(bytes_)


def test_recovery_that_is_interrupted_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_frames(tmp_path / "a.mcap", some_frames(300))

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ohmskin.mcap.repair.Disk.commit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        recover(tmp_path / "a.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_file_that_shrinks_while_it_is_read_ends_early(tmp_path: Path) -> None:
    write_frames(tmp_path / "a.mcap", some_frames(200))
    with Container(tmp_path / "a.mcap") as container:
        messages = container.messages()
        next(messages)
        (tmp_path / "a.mcap").write_bytes(b"")
        assert len(list(messages)) < 200
        assert not container.whole


# --- contacts and modes -----------------------------------------------------------------------------------------------


KNOWN = Contact(
    (0.05, 0.12), 2e-4, -3e-4, 0.97, -0.4, 7, ((2e-6, 1e-7), (1e-7, 1e-6)), (0.03, -0.02), 8e-3, 5.0, 0.4, 2e4, 2.5e-4
)


@pytest.mark.parametrize("contact", [KNOWN, replace(KNOWN, covariance=None, velocity=None, radius=None)])
def test_every_field_of_a_contact_comes_back(contact: Contact) -> None:
    back = decode_touch(encode_touch(1, 0.5, 9, "16T", [4], [contact, replace(contact, id=8)]))
    assert back.contacts == (contact, replace(contact, id=8))


def test_a_new_field_of_a_contact_reaches_every_encoding() -> None:
    """Each encoding takes its fields from the table, and the table has all that a contact has."""
    named = {field.name for field in dataclass_fields(Contact)}
    assert {field.name for field in contact_fields(2)} == named == as_json(KNOWN).keys()
    assert {field.name for field in contact_fields(3)} == named | {"normal", "self_touch"}
    assert {f.name for f in dataclass_fields(ohm.client.PlacedContact)} == named | {
        "normal",
        "patch",
        "frame",
        "self_touch",
    }
    assert len(columns()) == len(components(2)) == len(numbers(KNOWN, 2)) == 17
    assert as_json(KNOWN)["covariance"] == [2e-6, 1e-7, 1e-6]
    assert as_json(replace(KNOWN, velocity=None))["velocity"] is None


def test_infinite_pixels_are_exported_without_a_warning(tmp_path: Path) -> None:
    metadata = {"ohmskin": {"format": "1"}, "raster": {"x0": "0", "y0": "0", "pitch": "inf"}}
    writer, (frame,) = RecordingWriter(str(tmp_path / "a.mcap"), metadata, {}), some_frames(1)
    writer.add(PATTERN, 0, 0, encode_pattern(frame.pattern))
    writer.add(FRAME, 0, 0, encode_frame(frame, 0, 0.0, Role.BASE, ""))
    writer.add(IMAGE, 0, 0, encode_image(np.zeros((2, 3)), 0))
    writer.close()
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert write_npz(tmp_path / "a.npz", reader)["images"] == (1, 2, 3)


def test_recordings_of_the_first_version_are_read() -> None:
    """Their contacts have seven numbers; the file was written by 0.1.0."""
    with RecordingReader(Path(__file__).with_name("data") / "contacts-of-0.1.0.mcap") as reader:
        assert (len(reader.frames), len(reader.touches), dict(reader.recorded_modes)) == (4, 3, {})
        first = Contact((0.01, 0.02), 1e-4, -2e-4, 0.5, -0.25, 3)
        second = Contact((0.1, 0.11), 3e-4, 4e-4, 0.75, 0.5, 4)
        moved = [replace(first, position=(0.01 * k, 0.02)) for k in (1, 2, 3)]
        assert [touch.contacts for touch in reader.touches] == [(moved[0],), (moved[1], second), (moved[2], second)]


def test_modes_are_kept(tmp_path: Path) -> None:
    mode = ohm.Mode("quick", "tracking", "fit", prior="matern", injections=6, title="Quick")
    with Recorder(tmp_path / "a.mcap", SKIN, 0, modes=[mode]) as recorder, Bench() as bench:
        recorder.tee(bench).scan(adjacent([SKIN.electrodes.rings[0]]))
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert reader.recorded_modes == {"quick": {**mode.entries, "adjustable": True}}


@pytest.mark.parametrize("text", ["", "[]", '{"16T": 1}', "[" * 100_000, '{"a": {}}' + " " * 2**20])
def test_modes_that_cannot_be_read_are_as_if_not_told(tmp_path: Path, text: str) -> None:
    with pytest.raises(DataError, match="object of objects"):
        decode_modes(text)
    write_frames(tmp_path / "a.mcap", some_frames(2), modes=text)
    with RecordingReader(tmp_path / "a.mcap") as reader:
        assert (len(reader.frames), dict(reader.recorded_modes)) == (2, {})
