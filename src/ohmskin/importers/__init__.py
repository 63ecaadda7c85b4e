"""Recordings as they are read, ours and those of others (tables, EIDORS, Kuopio), and models of others."""

from ohmskin.importers.model import ImportedModel, read_model
from ohmskin.importers.recording import Recording, read_recording

__all__ = ["ImportedModel", "Recording", "read_model", "read_recording"]
