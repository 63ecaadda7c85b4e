"""Contacts over time: a filter on the data with births, lifts and drift; nearest neighbours for contacts of images."""

from ohmskin.tracking.filter import ContactFilter
from ohmskin.tracking.motion import Motion
from ohmskin.tracking.neighbour import Tracker, Tracks
from ohmskin.tracking.state import TrackState

__all__ = ["ContactFilter", "Motion", "TrackState", "Tracker", "Tracks"]
