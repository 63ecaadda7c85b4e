"""Recordings, ours and others'."""

from ohmskin.record.messages import FrameRecord, Role, TouchRecord
from ohmskin.record.pipe import Progress, WriterPipe
from ohmskin.record.recording import Recording, read_recording
from ohmskin.record.repair import Recovery, recover
from ohmskin.record.tape import Tape, is_tape

__all__ = [
    "FrameRecord",
    "Progress",
    "Recording",
    "Recovery",
    "Role",
    "Tape",
    "TouchRecord",
    "WriterPipe",
    "is_tape",
    "read_recording",
    "recover",
]
