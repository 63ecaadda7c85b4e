"""Variables of a MATLAB file (versions 5 to 7), with limits that damaged files cannot exceed.

A reader of our own, because SciPy's crashes the process on some damaged files (version 1.17.1; a few changed bytes are
enough). It reads numbers, sparse matrices, text, cells and structs; other kinds (objects, function handles) become
None. Nothing is copied until `numbers` asks for it, and what a file unpacks to, nests and claims is bounded.

The format: https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf. A file is a chain of elements, each a
kind, a size and its data; a variable is an element of elements: flags, dimensions, name, contents.
"""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ohmskin.arrays import Floats, quiet_nans
from ohmskin.errors import DataError

_LARGEST = 256 * 2**20  # bytes, unpacked
_DEEPEST = 16
_MOST_ELEMENTS = 2**18
_MOST_FIELDS, _MOST_DIMENSIONS, _LONGEST_NAME, _LONGEST_TEXT = 4096, 32, 64, 2**16  # MATLAB's names have 63 at most
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _DOUBLE, _UINT64 = 1, 2, 3, 4, 5, 6, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}

_Element = tuple[int, memoryview]


class _DamagedError(Exception):
    """What is wrong with the file."""


@dataclass(frozen=True)
class _Sparse:
    """A sparse matrix by columns, as it lies in the file."""

    shape: tuple[int, ...]
    rows: np.ndarray
    starts: np.ndarray
    values: np.ndarray


def is_mat(head: bytes) -> bool:
    """Whether a file that begins like this is a MATLAB file, of version 5, 7 or 7.3."""
    return head.startswith((b"MATLAB ", b"\x89HDF"))


def load_variables(content: bytes, name: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The variables of a MATLAB file by name: arrays, text, lists of cells, and lists of dicts for struct arrays.

    Also notes on what was left out.

    Args:
        content: The file's bytes.
        name: What to call the file in errors.

    Raises:
        DataError: If it is of another version, damaged, or claims more than it may.
    """
    if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise DataError(f"{name} is a MATLAB 7.3 (HDF5) file; save it again with save('file.mat', ..., '-v7')")
    if len(content) < 128 or content[126:128] not in (b"IM", b"MI"):
        raise DataError(f"{name} is not a whole MATLAB 5 file; its header of 128 bytes is truncated or damaged")
    try:
        reader = _Reader("<" if content[126:128] == b"IM" else ">")
        variables = reader.variables(memoryview(content)[128:])
    except _DamagedError as error:
        raise DataError(f"{name} {error}; save only what was measured, and copy the file again") from error
    parts = "imaginary parts are left out: contacts are found from real ones"
    return variables, (f"{', '.join(map(repr, reader.complex[:8]))}: {parts}",) if reader.complex else ()


def numbers(value: Any, what: str, largest: int = 2**24) -> Floats:
    """A numeric variable as an array of two dimensions, without imaginary parts (`load_variables` says so).

    Raises:
        DataError: If it is not numeric, is damaged, or has more than `largest` entries.
    """
    shape = value.shape if isinstance(value, _Sparse | np.ndarray) else ()
    if len(shape) != 2 or math.prod(shape) > largest:
        kind = f"an array of shape {shape}" if shape else f"of type {type(value).__name__}"
        raise DataError(f"{what} is {kind}; need a matrix of numbers with at most {largest} entries")
    if isinstance(value, np.ndarray):
        return quiet_nans(value)
    starts, rows = value.starts.astype(np.int64), value.rows.astype(np.int64)
    whole = len(starts) == shape[1] + 1 and starts[0] == 0 and (np.diff(starts) >= 0).all()
    if not whole or not starts[-1] <= min(len(rows), len(value.values)):
        raise DataError(f"{what} is a damaged sparse matrix: its columns do not follow each other")
    rows, values = rows[: starts[-1]], value.values[: starts[-1]]
    if len(rows) and not (rows.min() >= 0 and rows.max() < shape[0]):
        raise DataError(f"{what} is a damaged sparse matrix: rows {rows.min()}..{rows.max()} of {shape[0]}")
    dense = np.zeros(shape)
    np.add.at(dense, (rows, np.repeat(np.arange(shape[1]), np.diff(starts))), quiet_nans(values))
    return dense


def entries(value: Any) -> list[dict[str, Any]]:
    """The elements of a struct array; empty if it is none."""
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def _name(content: memoryview) -> str:
    return bytes(content).split(b"\0")[0].decode("latin-1")


class _Reader:
    """Reads the elements of one file; `order` is its byte order."""

    def __init__(self, order: str) -> None:
        self._order, self._bytes, self._elements = order, _LARGEST, _MOST_ELEMENTS
        self.complex: list[str] = []  # variables of which a part, not zero, is imaginary
        self._imaginary = False

    def variables(self, content: memoryview) -> dict[str, Any]:
        found = {}
        for kind, body in self._split(content):
            for inner_kind, inner in self._split(self._unpack(body)) if kind == _COMPRESSED else [(kind, body)]:
                if inner_kind == _MATRIX and len(inner):
                    self._imaginary = False
                    name, value = self._matrix(inner, 1)
                    found[name] = value
                    self.complex += [name[:40]] * self._imaginary
        return {name: value for name, value in found.items() if name and not name.startswith("__")}

    def _unpack(self, body: memoryview) -> memoryview:
        unpacker = zlib.decompressobj()
        try:
            unpacked = unpacker.decompress(body, self._bytes)
        except zlib.error as error:
            raise _DamagedError(f"is damaged: {error}") from error
        if unpacker.unconsumed_tail or len(unpacked) >= self._bytes:
            raise _DamagedError(f"unpacks to more than {_LARGEST // 2**20} MiB")
        self._bytes -= len(unpacked)
        return memoryview(unpacked)

    def _split(self, block: memoryview) -> list[_Element]:
        """The elements that lie one after the other in a block."""
        found: list[_Element] = []
        at = 0
        while at + 8 <= len(block):
            kind, size = struct.unpack_from(self._order + "II", block, at)
            if kind >> 16:  # a small element: up to four bytes of data inside the tag
                kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
                if size > 4:
                    raise _DamagedError(f"is damaged: a small element of {size} bytes")
            else:
                start, step = at + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
            if start + size > len(block):
                raise _DamagedError(f"is truncated: an element of {size} bytes has {len(block) - start}")
            found.append((kind, block[start : start + size]))
            at += step
            self._elements -= 1
            if self._elements < 0:
                raise _DamagedError(f"has more than {_MOST_ELEMENTS} elements")
        return found

    def _matrix(self, body: memoryview, depth: int) -> tuple[str, Any]:
        if depth > _DEEPEST:
            raise _DamagedError(f"nests variables more than {_DEEPEST} deep")
        parts = self._split(body)
        if len(parts) < 3 or len(parts[0][1]) < 4:
            return "", None
        kind = struct.unpack_from(self._order + "I", parts[0][1])[0] & 0xFF
        if len(parts[1][1]) > 4 * _MOST_DIMENSIONS:
            raise _DamagedError(f"has an array of more than {_MOST_DIMENSIONS} dimensions")
        shape = tuple(self._array(5, parts[1][1]).tolist())
        name, rest = _name(parts[2][1][:_LONGEST_NAME]), parts[3:]
        if len(shape) < 2 or min(shape) < 0:
            raise _DamagedError(f"is damaged: {name!r} has the shape {shape}")
        if kind == _SPARSE or _DOUBLE <= kind <= _UINT64:
            self._imaginary |= any(self._array(*part).any() for part in rest[3 if kind == _SPARSE else 1 :])
        if _DOUBLE <= kind <= _UINT64:
            return name, self._filled(shape, rest, name)
        if kind == _SPARSE and len(rest) >= 3:
            return name, _Sparse(shape, *(self._array(*part) for part in rest[:3]))
        if kind == _CHAR and rest and len(rest[0][1]) <= _LONGEST_TEXT:
            return name, bytes(rest[0][1]).decode(self._encoding(rest[0][0]), "replace")
        if kind in (_CELL, _STRUCT, _OBJECT):
            return name, self._parts(kind, math.prod(shape), rest, depth)
        return name, None

    def _filled(self, shape: tuple[int, ...], rest: list[_Element], name: str) -> np.ndarray:
        array = self._array(*rest[0]) if rest else np.empty(0)
        try:
            return array.reshape(shape, order="F")
        except ValueError:
            text = f"is damaged: {name!r} claims the shape {shape} and has {array.size} numbers"
            raise _DamagedError(text) from None

    def _parts(self, kind: int, count: int, rest: list[_Element], depth: int) -> list[Any]:
        """Cells as a list of values, structs as a list of dicts."""
        names = [""]
        if kind != _CELL:
            head = 3 if kind == _OBJECT else 2
            lengths = self._array(5, rest[head - 2][1]) if len(rest) >= head else np.empty(0)
            if len(lengths) != 1 or lengths[0] < 1:
                raise _DamagedError("is damaged: a struct has no names of fields")
            packed, length, rest = rest[head - 1][1], int(lengths[0]), rest[head:]
            fields = -(-len(packed) // length)
            if fields > _MOST_FIELDS or count * fields != len(rest):  # counted before any is made
                raise _DamagedError(
                    f"is damaged: it claims {count} structs of {fields} fields and has {len(rest)} parts"
                )
            names = [_name(packed[k : k + min(length, _LONGEST_NAME)]) for k in range(0, len(packed), length)]
        if count * len(names) != len(rest):
            raise _DamagedError(f"is damaged: it claims an array of {count} parts and has {len(rest)}")
        values = [self._matrix(body, depth + 1)[1] if part == _MATRIX and len(body) else None for part, body in rest]
        if kind == _CELL:
            return values
        starts = range(0, len(values), max(1, len(names)))
        return [dict(zip(names, values[k : k + len(names)], strict=True)) for k in starts]

    def _array(self, kind: int, body: memoryview) -> np.ndarray:
        if kind not in _NUMBERS:
            raise _DamagedError(f"is damaged: numbers of the unknown kind {kind}")
        dtype = np.dtype(self._order + _NUMBERS[kind])
        return np.frombuffer(body[: len(body) // dtype.itemsize * dtype.itemsize], dtype)

    def _encoding(self, kind: int) -> str:
        encoding = _TEXTS.get(kind, "latin-1")
        return encoding + ("-le" if self._order == "<" else "-be") if encoding in ("utf-16", "utf-32") else encoding
