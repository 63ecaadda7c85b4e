"""What `fuzzing` changes, field by field, and who reads it: files and streams that our own writers made."""

import io
import random
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import lz4.frame
import numpy as np
import scipy.io
import scipy.sparse as sp
from fuzzing import FLOATS, NUMBERS, Kind, spoilt
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata

import ohmskin as ohm
from ohmskin.device.replay import ReplayDevice, recorded_skin
from ohmskin.engine import Engine
from ohmskin.errors import OhmskinError
from ohmskin.importers import read_recording
from ohmskin.importers.model import read_model
from ohmskin.mcap import RecordingReader, recover
from ohmskin.recording import export
from ohmskin.scan import assess
from ohmskin.sensing import drive_of, modes
from ohmskin.skin import Skin

RIM8 = Skin.parse(
    "[imaging]\nmesh_size = 20e-3\n[electrode]\nlayout = 'rim'\ncount = 8\n[contact_layer]\ncolumns = 8\nrows = 8\n"
    "patch = 0.02"
)
COARSE = Skin.parse("[imaging]\nmesh_size = 12e-3\n[contact_layer]\ncolumns = 6\nrows = 6\npatch = 0.02")
WORDS = (
    "",
    " ",
    "x",
    "é\u202e",
    "\x1b[31m",
    "nan",
    "inf",
    "-1",
    "1e999",
    "1" * 400,
    "a" * 70000,
    "../../x",
    "\0",
    "$x^{$",
)
_RECORD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")


def some_value(rng: random.Random) -> Any:
    """Anything that JSON or TOML can say."""
    match rng.randrange(8):
        case 0 | 1:
            return rng.choice(NUMBERS) * rng.choice((1, 1, -1))
        case 2 | 3:
            return rng.choice(FLOATS)
        case 4:
            return rng.choice(WORDS)
        case 5:
            return rng.choice((True, False, [], {}, [[]], [{}], {"": 1}))
        case 6:
            return [some_value(rng) for _ in range(rng.randrange(4))]
        case _:
            return 10 ** rng.choice((10, 100, 308, 400, 5000))


def changed(tree: Any, rng: random.Random, value: Callable[[random.Random, Any], Any]) -> Any:
    """A tree of dicts and lists with one entry changed, left out, doubled or under another's name."""
    places: list[tuple[Any, Any]] = []

    def collect(part: Any) -> None:
        entries = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
        for key, inside in entries:
            places.append((part, key))
            collect(inside)

    collect(tree)
    if not places:
        return tree
    part, key = rng.choice(places)
    match rng.randrange(8):
        case 0:
            del part[key]
        case 1 if isinstance(part, dict):
            part[rng.choice((*WORDS[:4], *map(str, part)))] = part.pop(key)
        case 2 if isinstance(part, list):
            part.extend([part[key]] * rng.choice((1, 3, 40)))
        case _:
            part[key] = value(rng, part[key])
    return tree


def near(rng: random.Random, old: Any) -> Any:
    """A value like the old one, or any."""
    if isinstance(old, bool) or not isinstance(old, int | float) or rng.random() < 0.4:
        return some_value(rng)
    factor = rng.choice((0, -1, 0.5, 0.9, 1.1, 2, 10, 1e3, 1e-3))
    return type(old)(old * factor) if abs(old) < 1e300 else old


class Recordings:
    """Recordings in MCAP: records, metadata and messages changed, checksums and sizes as they should be, or not."""

    allowed = (OhmskinError,)

    def __init__(self, folder: Path) -> None:
        from recordings import record_press, some_frames
        from test_mcap import write_frames

        write_frames(folder / "frames.mcap", some_frames(6))
        with patch("ohmskin.engine.quiet._REPEATS", 6):
            record_press(folder / "press.mcap", "8O", cycles=8, skin=RIM8)
            record_press(folder / "tracked.mcap", "8T", cycles=4, images=0, skin=RIM8)
        self._bases = [path.read_bytes() for path in sorted(folder.glob("*.mcap"))]
        self._bases += [(Path(__file__).parent / "data" / "contacts-of-0.1.0.mcap").read_bytes()]

    def make(self, rng: random.Random) -> bytes:
        base = rng.choice(self._bases)
        if rng.random() < 0.3:
            return spoilt(base, rng)
        whole = [self._record(opcode, body, rng) for opcode, body in _records(base[8:-8])]
        if rng.random() < 0.1:
            rng.shuffle(whole)
        elif rng.random() < 0.1:
            at = rng.randrange(len(whole))
            whole[at:at] = whole[at : at + 1] * rng.choice((1, 5, 200))
        content = base[:8] + b"".join(whole) + base[-8:]
        return spoilt(content, rng) if rng.random() < 0.1 else content

    def _record(self, opcode: int, body: bytes, rng: random.Random) -> bytes:
        if opcode == Opcode.CHUNK:
            inside = [self._inner(*record, rng) for record in _records(_unpacked(body))]
            if rng.random() < 0.1:
                rng.shuffle(inside)
            return _chunk(b"".join(inside), body, rng)
        if rng.random() < 0.3 and opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
            builder, stream = RecordBuilder(), ReadDataStream(io.BytesIO(body))
            if opcode == Opcode.METADATA:
                record = Metadata.read(stream)
                texts = record.metadata.items()
                record.metadata = {k: v if rng.random() < 0.8 else _text(rng, v) for k, v in texts}
                record.write(builder)
            else:
                attached = Attachment.read(stream)
                attached.data = spoilt(attached.data, rng)
                attached.write(builder)
            return bytes(builder.end())
        return _RECORD.pack(opcode, len(body)) + body

    def _inner(self, opcode: int, body: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.03:
            start = 22 if opcode == Opcode.MESSAGE and rng.random() < 0.8 else 0
            if rng.random() < 0.6 and len(body) > start + 16:  # a number, where numbers are
                size = rng.choice((1, 4, 8))
                at = start + 4 + size * rng.randrange((len(body) - start - 4) // size)
                number = rng.choice(NUMBERS) % 256**size
                new = struct.pack("<d", rng.choice(FLOATS)) if size == 8 and rng.random() < 0.6 else None
                body = body[:at] + (new or number.to_bytes(size, "little")) + body[at + size :]
            else:
                body = body[:start] + spoilt(body[start:], rng)
        return _RECORD.pack(opcode, len(body)) + body

    def use(self, content: bytes, rng: random.Random) -> None:
        path = Path("case.mcap")
        path.write_bytes(content)
        for own in Path().glob("case.*"):
            if own != path:
                own.unlink()
        with suppress(OhmskinError):
            recover(path)
        with RecordingReader(path) as reader:
            for each in (reader.frames, reader.touches, reader.images, reader.log):
                for k in range(len(each)):
                    with suppress(OhmskinError):
                        each[k]
                reader.times_of(each)
            for write in (
                lambda: export.write_csv(Path("case.csv"), export.FRAME_COLUMNS, export.frame_rows(reader)),
                lambda: export.write_csv(
                    Path("case.contacts.csv"), export.CONTACT_COLUMNS, export.contact_rows(reader)
                ),
                lambda: export.write_npz(Path("case.npz"), reader),
            ):
                if rng.random() < 0.2:
                    with suppress(OhmskinError):
                        write()
        with ReplayDevice("replay:case.mcap", speed=1e9) as device:
            skin = recorded_skin(device)
            if rng.random() < 0.9:
                for mode in modes(skin).values():
                    with suppress(OhmskinError):
                        device.scan(drive_of(mode, skin).next((), 0))
                return
        quick = replace(skin, imaging=replace(skin.imaging, mesh_size=max(skin.imaging.mesh_size, 12e-3)))
        with Engine(lambda: ReplayDevice("replay:case.mcap", speed=1e9), quick) as engine:
            engine.calibrate()
            for _ in range(3):
                engine.step()


def _records(content: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while at + _RECORD.size <= len(content):
        opcode, length = _RECORD.unpack_from(content, at)
        at += _RECORD.size + length
        found.append((opcode, content[at - length : at]))
    return found


def _unpacked(chunk: bytes) -> bytes:
    (length,) = struct.unpack_from("<I", chunk, 28)
    packed = chunk[32 + length + 8 :]
    return lz4.frame.decompress(packed) if length else packed


def _chunk(records: bytes, old: bytes, rng: random.Random) -> bytes:
    packed, name = (lz4.frame.compress(records), b"lz4") if rng.random() < 0.7 else (records, b"")
    size, crc = len(records), zlib.crc32(records)
    if rng.random() < 0.05:
        size = rng.choice(NUMBERS)
    body = old[:16] + struct.pack("<QII", size, crc if rng.random() < 0.9 else 0, len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    return _RECORD.pack(Opcode.CHUNK, len(body)) + body


def _text(rng: random.Random, old: str) -> str:
    if rng.random() < 0.5:
        return rng.choice((*WORDS, *map(str, NUMBERS), *map(str, FLOATS)))
    return spoilt(old.encode(), rng).decode(errors="ignore")


class Matrices:
    """MATLAB files: variables and fields of another kind, shape or value; elements of another kind or size."""

    allowed = (OhmskinError,)

    def __init__(self, _: Path) -> None:
        pairs = np.eye(8) - np.roll(np.eye(8), 1, axis=0)
        rows = pairs[:, 2:7].T
        stimulation = [
            {
                "stimulation": "mA",
                "stim_pattern": sp.csc_matrix(pairs[:, k : k + 1]),
                "meas_pattern": sp.csc_matrix(np.roll(rows, k, axis=1)),
            }
            for k in range(8)
        ]
        mesh = ohm.mesh_domain(ohm.Rectangle(0.2, 0.2), 0.05)
        electrode = [{"nodes": np.array([[k + 1.0]]), "z_contact": 0.01} for k in np.unique(mesh.boundary)[:8]]
        electrode[0] = {"nodes": mesh.boundary[0] + 1.0, "z_contact": 0.01}
        model = {"nodes": mesh.nodes, "elems": mesh.elements + 1.0, "electrode": electrode, "stimulation": stimulation}
        volts = np.random.default_rng(0).normal(size=(40, 3))
        self._bases: list[dict[str, Any]] = [
            {"fmdl": {"stimulation": stimulation, "meas_select": np.ones((40, 1))}, "vh": volts[:, :1], "vi": volts},
            {
                "img": {"fwd_model": model, "elem_data": np.ones((mesh.n_elem, 1))},
                "vh": {"meas": volts[:, :1]},
                "vi": volts,
            },
            {"stim_pattern": pairs, "meas_pattern": rows, "vh": volts[:, :1], "vi": volts},
            {
                "stim_meas_list": np.array([[1, 2, 3, 4], [2, 3, 4, 5], [1, 2, 4, 5]]),
                "vh": volts[:3, :1],
                "vi": volts[:3],
            },
            {"CurrentPattern": pairs, "MeasPattern": pairs, "Uel": np.ones((8, 8))},
            {"Inj": pairs, "Mpat": pairs, "Uel": np.ones((64, 1)), "Injref": pairs, "Uelref": np.ones((64, 1))},
        ]

    def make(self, rng: random.Random) -> bytes:
        variables = copied(rng.choice(self._bases))
        for _ in range(rng.choice((0, 1, 1, 2, 3))):
            variables = changed(variables, rng, _matrix)
        file = io.BytesIO()
        try:
            scipy.io.savemat(file, _written(variables), do_compression=rng.random() < 0.3)
        except Exception:  # noqa: BLE001  what SciPy does not write is no file
            return self.make(rng)
        content = file.getvalue()
        if rng.random() < 0.4:
            content = content[:128] + _elements(content[128:], rng)
        return spoilt(content, rng) if rng.random() < 0.2 else content

    def use(self, content: bytes, rng: random.Random) -> None:
        name = rng.choice(("datamat_1_0.mat", "ref.mat", "any.mat"))
        Path(name).write_bytes(content)
        with suppress(OhmskinError):
            model = read_model(name, contact_impedance=rng.choice((None, 0.01)))
            model.transfer_model().pair_resistances  # noqa: B018  it is computed when asked for
        recording = read_recording(name, driven=rng.random() < 0.5)
        assess(recording.quiet, recording.frames)


def copied(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: copied(value) for key, value in tree.items()}
    return [copied(value) for value in tree] if isinstance(tree, list) else tree


def _written(tree: Any) -> Any:
    """Lists of dicts with the same keys as struct arrays, as EIDORS has them; other lists become cells."""
    if isinstance(tree, dict):
        return {key or "x": _written(value) for key, value in tree.items()}
    if not isinstance(tree, list):
        return tree
    tree = [_written(value) for value in tree]
    if not (tree and all(isinstance(part, dict) and part and part.keys() == tree[0].keys() for part in tree)):
        return np.array([*tree, None], object)[:-1]  # a row of cells, whatever is in them
    found = np.zeros((1, len(tree)), [(key, object) for key in tree[0]])
    for k, part in enumerate(tree):
        found[0, k] = tuple(part.values())
    return found


def _matrix(rng: random.Random, old: Any) -> Any:
    """Another array for an array, or anything else."""
    array = old.toarray() if sp.issparse(old) else np.array(old) if isinstance(old, np.ndarray) else None
    if array is None or rng.random() < 0.2:
        value = rng.choice(
            (1.0, np.nan, "mA", "", "x" * 3000, np.zeros((0, 0)), {"a": 1}, [1, "a"], np.array([[1 + 2j]]))
        )
        return rng.choice(NUMBERS) if rng.random() < 0.2 else value
    if array.size and rng.random() < 0.5:
        at = rng.randrange(array.size)
        array.flat[at] = rng.choice((*FLOATS, -1, 2, 1e7))
        return array if rng.random() < 0.7 or array.ndim > 2 else sp.csc_matrix(array)
    match rng.randrange(8):
        case 0:
            return array.T
        case 1:
            return array[: array.shape[0] // 2]
        case 2:
            return array * rng.choice((0, -1, 1e300, np.nan, 1j, 1e-300))
        case 3:
            return np.zeros((rng.choice((0, 1, 8)), rng.choice((0, 1, 8, 5000))))
        case 4:
            return array[None]
        case 5:
            return np.tile(array, (rng.choice((1, 2, 30)), rng.choice((1, 2, 30))))
        case 6:
            return np.round(np.nan_to_num(array)).clip(-100, 100).astype(rng.choice(("i1", "u1", "i8", "f4")))
        case _:
            return sp.csc_matrix(array) if array.ndim == 2 else array


def _elements(content: bytes, rng: random.Random, depth: int = 0) -> bytes:
    """The elements of a MATLAB file with one of another kind or size, however deep."""
    made, at = [], 0
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        if kind >> 16:
            made.append(content[at : at + 8])
            at += 8
            continue
        body = content[at + 8 : at + 8 + size]
        at += 8 + size + (0 if kind == 15 else -size % 8)
        if kind == 15 and rng.random() < 0.5:
            with suppress(zlib.error):
                body = zlib.compress(_elements(zlib.decompress(body), rng, depth))
        elif kind == 14 and depth < 6 and rng.random() < 0.5:
            body = _elements(body, rng, depth + 1)
        elif rng.random() < 0.1:
            body = spoilt(body, rng)
        if rng.random() < 0.05:
            kind = rng.randrange(20)
        size = rng.choice(NUMBERS) % 2**32 if rng.random() < 0.03 else len(body)
        made.append(struct.pack("<II", kind, size) + body + bytes(0 if kind == 15 else -len(body) % 8))
    return b"".join(made)


FILES: dict[str, Callable[[Path], Kind]] = {"mcap": Recordings, "mat": Matrices}
