"""Recordings as tables, arrays, pictures and videos, for those who read them elsewhere."""

import csv
import os
import secrets
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ohmskin.client.fields import columns, numbers
from ohmskin.errors import DataError
from ohmskin.mcap import RecordingReader
from ohmskin.recording.player import Replayed, reimage

CONTACT_COLUMNS = ("time_s", "cycle", "mode", *columns())
"""A row per contact and cycle; `time_s` counts from the first frame behind the calibration. NaN: not known."""

FRAME_COLUMNS = (
    *("time_s", "device_time_s", "sequence", "role", "mode", "source", "sink", "plus", "minus"),
    *("current_A", "voltage_V", "auxiliary"),
)
"""A row per measured voltage; `role` is untold, base, chosen or quiet; `auxiliary` (N or Pa) is the frame's, empty
without such a channel."""

_ROWS_AT_ONCE = 65536
_MOST_VALUES = 2**28  # of one array held in memory


def contact_rows(reader: RecordingReader, start: float = -np.inf, stop: float = np.inf) -> Iterator[tuple[Any, ...]]:
    """The recorded contacts (`CONTACT_COLUMNS`) between two times (s)."""
    times = reader.times_of(reader.touches)
    for k in np.flatnonzero((times >= start) & (times <= stop)):
        touch = reader.touches[int(k)]
        for contact in touch.contacts:
            yield (float(times[k]), touch.sequence, touch.mode, *numbers(contact, 2))


def frame_rows(reader: RecordingReader, start: float = -np.inf, stop: float = np.inf) -> Iterator[tuple[Any, ...]]:
    """The recorded voltages (`FRAME_COLUMNS`) of frames between two times (s)."""
    for k in _within(reader, start, stop):
        record, pattern = reader.frames[int(k)], reader.pattern(int(k))
        frame = record.frame(pattern)
        head = (float(reader.times[k]), record.time, record.sequence, record.role.name.lower(), record.mode)
        amperes, volts = frame.measurement_currents.tolist(), frame.voltages.tolist()
        rows = zip(pattern.quadruples.tolist(), amperes, volts, strict=True)
        for quadruple, current, voltage in rows:
            yield (*head, *quadruple, current, voltage, record.auxiliary)


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[tuple[Any, ...]]) -> int:
    """Write a table with a header; the number of its rows.

    Raises:
        DataError: If the file exists or cannot be written.
    """
    count = 0
    with _new(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for count, row in enumerate(rows, 1):  # noqa: B007
            writer.writerow(row)
    return count


def write_parquet(path: Path, columns: Iterable[str], rows: Iterable[tuple[Any, ...]]) -> int:
    """Write a table as Parquet, through pyarrow (extra `export`); the number of its rows.

    Raises:
        DataError: If pyarrow is missing, or the file exists or cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise DataError("Parquet needs pyarrow: pip install 'ohmskin[export]'; or choose csv or npz") from error
    names = tuple(columns)
    known = dict.fromkeys(("mode", "role"), pa.string()) | dict.fromkeys(("cycle", "sequence"), pa.uint64())
    known |= dict.fromkeys(("id", "source", "sink", "plus", "minus"), pa.int64())
    kinds = [known.get(name, pa.float64()) for name in names]
    schema = pa.schema(list(zip(names, kinds, strict=True)))
    total, rows = 0, iter(rows)
    with _new(path) as part, pq.ParquetWriter(part, schema) as writer:
        while batch := list(islice(rows, _ROWS_AT_ONCE)):
            arrays = [pa.array(column, kind) for column, kind in zip(zip(*batch, strict=True), kinds, strict=True)]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
            total += len(batch)
    return total


def write_npz(
    path: Path, reader: RecordingReader, start: float = -np.inf, stop: float = np.inf
) -> dict[str, tuple[int, ...]]:
    """Write frames, patterns, contacts and images as NumPy arrays (docs/guide/recording.md); their shapes.

    Voltages of frame k are `voltages[voltages_start[k] : voltages_start[k + 1]]`; likewise currents and patterns.

    Raises:
        DataError: If the file exists or cannot be written, or so much does not fit into memory.
    """
    frames = _within(reader, start, stop)
    _, first, which = np.unique(reader.pattern_numbers[frames], return_index=True, return_inverse=True)
    patterns = [reader.pattern(int(frames[k])) for k in first]
    sizes = np.array([p.n_meas for p in patterns], np.int64)
    if (total := int(sizes[which].sum())) > _MOST_VALUES:
        raise DataError(f"{total} voltages are too many for one file; choose a part with --start and --seconds")
    records = [reader.frames[int(k)] for k in frames]
    images: list[Any] = []
    image_times, shape = [], (0, 0)
    times = reader.times_of(reader.images)
    for k in np.flatnonzero((times >= start) & (times <= stop)):
        image = reader.images[int(k)]
        shape = shape if images else image.shape
        if image.shape != shape:
            raise DataError(
                f"image {k} of {reader.path} has shape {image.shape}, not {shape}; export a part without it"
            )
        if (len(images) + 1) * image.size > _MOST_VALUES:
            raise DataError("the images are too many for one file; choose a part with --start and --seconds")
        images.append(image.astype(np.float32))
        image_times.append(times[k])
    contacts = list(contact_rows(reader, start, stop))
    table = zip(*contacts, strict=True) if contacts else [()] * len(CONTACT_COLUMNS)
    arrays: dict[str, Any] = {
        "frame_time_s": reader.times[frames],
        "frame_device_time_s": np.array([r.time for r in records]),
        "frame_sequence": np.array([r.sequence for r in records], np.uint64),
        "frame_auxiliary": np.array([np.nan if r.auxiliary is None else r.auxiliary for r in records]),
        "frame_flags": np.array([int(r.flags) for r in records], np.uint32),
        "frame_role": np.array([int(r.role) for r in records], np.uint8),
        "frame_pattern": which.astype(np.int64),
        **_joined("voltages", [r.voltages for r in records], np.empty(0)),
        **_joined("currents", [r.currents for r in records], np.empty(0)),
        **_joined("pattern_injections", [p.injections for p in patterns], np.empty((0, 2), np.int32)),
        **_joined("pattern_measurements", [p.measurements for p in patterns], np.empty((0, 3), np.int32)),
        "image_time_s": np.array(image_times),
        "images": np.array(images, np.float32).reshape(len(images), *shape),
        "skin_toml": np.array(reader.skin),
        **{f"contact_{name}": np.array(own) for name, own in zip(CONTACT_COLUMNS, table, strict=True)},
    }
    with suppress(KeyError, ValueError), np.errstate(all="ignore"):  # a damaged file may tell of infinite pixels
        raster = reader.metadata["raster"]
        arrays["image_x_m"] = float(raster["x0"]) + float(raster["pitch"]) * np.arange(shape[1])
        arrays["image_y_m"] = float(raster["y0"]) + float(raster["pitch"]) * np.arange(shape[0])
    with _new(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)
    return {name: array.shape for name, array in arrays.items()}


def save_comparison(path: Path, cycles: dict[str, Replayed]) -> None:
    """Save images with their contacts side by side, each under its title, each with colours of its own.

    Raises:
        DataError: If the file exists or cannot be written, or the extra `plot` is missing.
    """
    from ohmskin.plot.video import side_by_side  # here: it needs the extra `plot`

    figure = side_by_side({title: (cycle.known.model, cycle.touch.percept) for title, cycle in cycles.items()})
    with _new(path) as part:
        try:
            figure.savefig(part, dpi=120, format=path.suffix.lstrip(".") or "png")
        except ValueError as error:
            raise DataError(f"cannot write picture {path}: {error}") from error


def write_video(path: Path, cycles: Iterable[Replayed], rate: float = 25.0) -> int:
    """Write an MP4 video of `rate` pictures per recorded second, through ffmpeg; the number of its pictures.

    Each picture is of the newest cycle at its time. Colours stay fixed from the first one on.

    Raises:
        DataError: If ffmpeg or the extra `plot` is not installed, ffmpeg fails, there are no cycles, or the file
            exists.
    """
    from ohmskin.plot.video import VideoFigure, check_video  # here: it needs the extra `plot`

    check_video()
    cycles = iter(cycles)
    if (first := next(cycles, None)) is None:
        raise DataError("nothing was recorded in that time; choose another --start and --seconds")
    video = VideoFigure(first.known.model, first.touch.percept, max(0.3, 3 * first.thresholds.final))
    count, due = 0, first.time
    with _new(path) as part:
        try:
            with video.written(part, rate) as add:
                for cycle in chain([first], cycles):
                    while count and due + 1 / rate <= cycle.time:  # nothing new: the film stands still
                        add()
                        count, due = count + 1, due + 1 / rate
                    if cycle.time + 1e-9 >= due:
                        touch = cycle.touch
                        title = f"{touch.mode.name}   {cycle.time:7.2f} s"
                        video.show(cycle.known.model, touch.percept, touch.contacts, title)
                        add()
                        count, due = count + 1, due + 1 / rate
        except subprocess.CalledProcessError as error:
            why = error.stderr.strip()[:300] or "no reason given"
            raise DataError(f"ffmpeg failed (exit status {error.returncode}): {why}") from error
    return count


def strongest(cycles: Iterable[Replayed]) -> Replayed:
    """The cycle with the strongest contact that cycles before it confirm; without any, the highest image.

    Of many quiet cycles noise lets some show a contact; without a confirmed one, those come last.

    Raises:
        DataError: If there is no cycle.
    """
    best, height = None, (-1, -np.inf)
    for cycle in cycles:
        detections, contacts = cycle.touch.percept.detections, cycle.touch.contacts
        rank = 2 if detections and contacts else 0 if detections or contacts else 1
        most = max((abs(c.strength) for c in detections), default=float(np.abs(cycle.touch.percept.image.values).max()))
        if (rank, most) > height:
            best, height = cycle, (rank, most)
    if best is None:
        raise DataError("nothing was recorded in that time; choose another --start and --seconds")
    return best


def cycle_at(path: str | Path, at: float, **options: Any) -> Replayed:
    """The first cycle from a time on (s); `options` are those of `reimage`.

    Raises:
        DataError: If there is none.
    """
    for cycle in reimage(path, start=at, **options):
        return cycle
    raise DataError(f"no whole cycle was recorded from {at:g} s on; choose an earlier time")


def _within(reader: RecordingReader, start: float, stop: float) -> Any:
    return np.flatnonzero((reader.times >= start) & (reader.times <= stop))


def _joined(name: str, parts: Sequence[NDArray], none: NDArray) -> dict[str, NDArray]:
    """Arrays one after the other, of the type of `none`, and where each starts and the last one ends."""
    joined = np.concatenate([none, *parts]).astype(none.dtype)
    return {name: joined, f"{name}_start": np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)}


@contextmanager
def _new(path: Path) -> Iterator[Path]:
    """A name to write to; it becomes `path` when all went well, and `path` is never overwritten.

    Raises:
        DataError: If the file exists or cannot be written.
    """
    if os.path.exists(path):
        raise DataError(f"{path} exists and is never overwritten; choose another name")
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        part.touch(exist_ok=False)  # who may read it is for the user's umask to say
        try:
            yield part
            _rename(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror or error}; choose another place") from error


def _rename(part: Path, path: Path) -> None:
    """Give a file its name unless another one has it."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:  # no hard links here: a USB stick, say
        if path.exists():
            raise
        part.rename(path)
