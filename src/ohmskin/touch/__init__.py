"""From images to contacts: regions, contacts, tracking."""

from ohmskin.touch.contacts import Contact, ContactFinder, learn_threshold
from ohmskin.touch.regions import Region, find_regions, label_peaks
from ohmskin.touch.tracking import Tracker, Tracks

__all__ = ["Contact", "ContactFinder", "Region", "Tracker", "Tracks", "find_regions", "label_peaks", "learn_threshold"]
