"""Mends recordings that were cut short: all that can be read goes into a new file, with its index."""

from dataclasses import dataclass
from pathlib import Path

from ohmskin.errors import DataError
from ohmskin.mcap.container import Container
from ohmskin.mcap.schemas import FRAME, TOPICS
from ohmskin.mcap.writer import CHUNK_BYTES, Disk, open_writer

_COMMIT_EVERY = 256  # messages


@dataclass(frozen=True)
class Recovery:
    """What was recovered.

    Args:
        path: The repaired copy.
        frames: Frames in it.
        messages: Messages in it, frames included.
        lost: Bytes at the end of the original that could not be used.
        damaged: Number of other parts that could not be used.
        whole: Whether the original was intact.
    """

    path: Path
    frames: int
    messages: int
    lost: int
    damaged: int
    whole: bool


def recover(source: str | Path, target: str | Path | None = None) -> Recovery:
    """Copy all that can be read of a recording into a new file with a full index. The original is only read.

    Args:
        source: The recording, damaged or not; any MCAP file.
        target: The new file; NAME.recovered.mcap beside NAME.mcap unless given.

    Raises:
        DataError: If nothing can be read, the target exists or cannot be written.
    """
    source = Path(source)
    target = Path(target) if target is not None else source.with_name(f"{source.stem}.recovered.mcap")
    with Container(source) as container:
        try:
            disk = Disk(str(target))
        except FileExistsError as error:
            raise DataError(f"{target} exists and is never overwritten; choose another name") from error
        except OSError as error:
            raise DataError(f"cannot write {target}: {error}") from error
        try:
            frames, count = _copy(container, disk, target)
        except BaseException as error:  # Ctrl-C, too, leaves nothing behind
            disk.close()
            target.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise DataError(f"cannot read recording {source}: {error}") from error
            raise
        disk.close()
        lost = 0 if container.whole else container.size - container.end
        return Recovery(target, frames, count, lost, container.damaged, container.whole)


def _copy(container: Container, disk: Disk, target: Path) -> tuple[int, int]:
    """Copy all that can be read; the number of frames and of messages."""
    writer = open_writer(disk, CHUNK_BYTES)
    writer.start("ros2", library="ohmskin")
    numbers: dict[str, int] = {}
    frames = count = 0
    for topic, _, message in container.messages():
        if topic not in numbers:
            channel = next(c for c in reversed(container.channels.values()) if c.topic == topic)
            schema = container.schemas.get(channel.schema_id)
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            numbers[topic] = writer.register_channel(topic, channel.message_encoding, schema_id, channel.metadata)
        times = {"log_time": message.log_time, "publish_time": message.publish_time}
        writer.add_message(numbers[topic], data=message.data, sequence=message.sequence, **times)
        frames += topic == list(TOPICS)[FRAME]
        count += 1
        if count % _COMMIT_EVERY == 0:
            _commit(disk, target)
    if not count:
        raise DataError(f"{container.path} has no message that can be read; there is nothing to recover")
    for about in container.metadata.values():
        writer.add_metadata(about.name, about.metadata)
    for name, attached in container.attachments.items():
        writer.add_attachment(attached.create_time, attached.log_time, name, attached.media_type, attached.data)
    writer.finish()
    _commit(disk, target)
    return frames, count


def _commit(disk: Disk, target: Path) -> None:
    disk.commit(now=True)
    if disk.trouble:
        raise DataError(f"cannot write {target}: {disk.trouble}; make room, or choose another place")
