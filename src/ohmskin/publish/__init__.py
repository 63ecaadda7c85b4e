"""Sinks: where what the loop felt goes, beside the page: recordings, and other programs.

Parts are imported when they are first used: each publisher's process needs only its own.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOMES = {
    "Body": "body",
    "ESTIMATORS": "player",
    "Patches": "patches",
    "Player": "player",
    "Publisher": "publisher",
    "Recorder": "recorder",
    "Replayed": "player",
    "recorded_skin": "player",
    "reimage": "player",
}

if TYPE_CHECKING:
    from ohmskin.publish.body import Body
    from ohmskin.publish.patches import Patches
    from ohmskin.publish.player import ESTIMATORS, Player, Replayed, recorded_skin, reimage
    from ohmskin.publish.publisher import Publisher
    from ohmskin.publish.recorder import Recorder

__all__ = ["ESTIMATORS", "Body", "Patches", "Player", "Publisher", "Recorder", "Replayed", "recorded_skin", "reimage"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ohmskin.publish' has no attribute {name!r}")
    return getattr(import_module(f"ohmskin.publish.{_HOMES[name]}"), name)
