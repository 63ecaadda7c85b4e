"""From images and data to contacts: regions, contacts, tracking; contacts fitted to data, and followed over time."""

from ohmskin.touch.contacts import Contact, ContactFinder, learn_threshold
from ohmskin.touch.explain import Explainer, Solution
from ohmskin.touch.filter import ContactFilter, Motion, Scene
from ohmskin.touch.regions import Region, find_regions, label_peaks
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
