"""Gestures: what contacts do over time."""

from ohmskin.gestures.episode import Episode
from ohmskin.gestures.model import GESTURES, UNKNOWN, GestureModel
from ohmskin.gestures.reader import Gesture, GestureFollower, GestureReader, GestureState

__all__ = [
    "GESTURES",
    "UNKNOWN",
    "Episode",
    "Gesture",
    "GestureFollower",
    "GestureModel",
    "GestureReader",
    "GestureState",
]
