"""Recordings, ours and others'."""

from ohmskin.record.recording import Recording, read_recording

__all__ = ["Recording", "read_recording"]
