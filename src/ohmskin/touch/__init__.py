"""From images and data to contacts: regions, contacts, tracking; contacts fitted to data, and followed over time."""

from ohmskin.touch.contacts import Contact, ContactFinder, learn_threshold
from ohmskin.touch.explain import Explainer
from ohmskin.touch.filter import ContactFilter
from ohmskin.touch.motion import Motion
from ohmskin.touch.regions import Region, find_regions, label_peaks
from ohmskin.touch.scene import Scene
from ohmskin.touch.solution import Solution
from ohmskin.touch.tracking import Tracker, Tracks

__all__ = [
    "Contact",
    "ContactFilter",
    "ContactFinder",
    "Explainer",
    "Motion",
    "Region",
    "Scene",
    "Solution",
    "Tracker",
    "Tracks",
    "find_regions",
    "label_peaks",
    "learn_threshold",
]
