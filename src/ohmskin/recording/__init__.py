"""Recordings of ours: made while the loop runs (`Recorder`), replayed through it (`Player`, `reimage`), and read."""

from ohmskin.device.replay import recorded_skin
from ohmskin.mcap import Progress, Recovery, Role, Tape, is_tape, recover
from ohmskin.recording.player import Player, Replayed, reimage
from ohmskin.recording.recorder import Recorder

__all__ = [
    "Player",
    "Progress",
    "Recorder",
    "Recovery",
    "Replayed",
    "Role",
    "Tape",
    "is_tape",
    "recorded_skin",
    "recover",
    "reimage",
]
