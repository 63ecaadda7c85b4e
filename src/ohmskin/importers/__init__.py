"""Readers of recordings, ohmskin's and those of others (tables, EIDORS, Kuopio), and of others' models."""

from ohmskin.importers.model import ImportedModel, read_model
from ohmskin.importers.parts import Recording
from ohmskin.importers.presses import resolved
from ohmskin.importers.recording import read_recording

__all__ = ["ImportedModel", "Recording", "read_model", "read_recording", "resolved"]
