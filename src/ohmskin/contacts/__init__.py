"""Contacts: found in images (regions, eq. 6), or fitted to the data themselves."""

from ohmskin.contacts.finder import Contact, ContactFinder, learn_threshold
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.regions import Region, find_regions, label_peaks
from ohmskin.contacts.segments import CLASSES, Evidence, Segments, evidence, segments
from ohmskin.contacts.solution import Solution
from ohmskin.contacts.space import in_frame, on_skin

__all__ = [
    "CLASSES",
    "Contact",
    "ContactFinder",
    "ContactFitter",
    "Evidence",
    "Region",
    "Segments",
    "Solution",
    "evidence",
    "find_regions",
    "in_frame",
    "label_peaks",
    "learn_threshold",
    "on_skin",
    "segments",
]
