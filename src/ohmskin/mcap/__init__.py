"""Recordings in MCAP: their messages, the writer in a separate process, the reader, and the repair of truncated files.

Each is imported when it is first used: the writer's process needs neither NumPy nor the meaning of a recording.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors
    from ohmskin.mcap.messages import FrameRecord, Role, TouchRecord
    from ohmskin.mcap.pipe import Progress, WriterPipe
    from ohmskin.mcap.reader import RecordingReader, is_recording
    from ohmskin.mcap.repair import Recovery, recover

__all__ = [
    "FrameRecord",
    "Progress",
    "RecordingReader",
    "Recovery",
    "Role",
    "TouchRecord",
    "WriterPipe",
    "is_recording",
    "recover",
]

_HOMES = {
    **dict.fromkeys(("FrameRecord", "Role", "TouchRecord"), "messages"),
    **dict.fromkeys(("Progress", "WriterPipe"), "pipe"),
    **dict.fromkeys(("Recovery", "recover"), "repair"),
    **dict.fromkeys(("RecordingReader", "is_recording"), "reader"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
