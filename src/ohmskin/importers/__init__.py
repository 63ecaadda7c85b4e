"""Recordings as they are read: ours, and those of others (tables, EIDORS, the data sets of Kuopio)."""

from ohmskin.importers.recording import Recording, read_recording

__all__ = ["Recording", "read_recording"]
