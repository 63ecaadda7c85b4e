"""Contacts: found in images (regions, eq. 6), or fitted to the data themselves."""

from ohmskin.contacts.finder import Contact, ContactFinder, learn_threshold, on_skin
from ohmskin.contacts.fitter import ContactFitter
from ohmskin.contacts.regions import Region, find_regions, label_peaks
from ohmskin.contacts.solution import Solution

__all__ = [
    "Contact",
    "ContactFinder",
    "ContactFitter",
    "Region",
    "Solution",
    "find_regions",
    "label_peaks",
    "learn_threshold",
    "on_skin",
]
