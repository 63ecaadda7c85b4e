"""Recordings in MCAP: their messages, the writer in a process of its own, the reader, and the repair of cut files."""

from ohmskin.mcap.messages import FrameRecord, Role, TouchRecord
from ohmskin.mcap.pipe import Progress, WriterPipe
from ohmskin.mcap.repair import Recovery, recover
from ohmskin.mcap.tape import Tape, is_tape

__all__ = ["FrameRecord", "Progress", "Recovery", "Role", "Tape", "TouchRecord", "WriterPipe", "is_tape", "recover"]
