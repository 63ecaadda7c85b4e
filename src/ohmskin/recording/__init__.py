"""Recordings: made while the loop runs (`Recorder`), replayed through it (`Player`, `reimage`), and read."""

from ohmskin.device.replay import recorded_skin
from ohmskin.mcap import Progress, RecordingReader, Recovery, Role, is_recording, recover
from ohmskin.recording.player import Player, Replayed, reimage
from ohmskin.recording.recorder import Recorder

__all__ = [
    "Player",
    "Progress",
    "Recorder",
    "RecordingReader",
    "Recovery",
    "Replayed",
    "Role",
    "is_recording",
    "recorded_skin",
    "recover",
    "reimage",
]
