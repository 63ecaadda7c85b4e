"""What to drive next: fixed sets, the paper's choice (eq. 7), choices by remaining uncertainty; position bounds."""

from ohmskin.drive.bound import ContactPrior, best_fixed, position_bound
from ohmskin.drive.design import Candidates, Search, Selection, exchange, greedy, pair_currents
from ohmskin.drive.drive import Drive, Exploration, Fixed, SecondScan, Target, TwoScans, WithDriven
from ohmskin.drive.drives import DRIVES, DriveSettings
from ohmskin.drive.layout import LayoutSearch, arranged
from ohmskin.drive.optimal import LocalDrive, OptimalDrive, pair_weights, round_robin
from ohmskin.drive.patterns import base_pattern, candidate_pairs, candidate_pattern, complete_pattern, part_of
from ohmskin.drive.position import PositionDrive, Ranking, TrackingDrive

__all__ = [
    "DRIVES",
    "Candidates",
    "ContactPrior",
    "Drive",
    "DriveSettings",
    "Exploration",
    "Fixed",
    "LayoutSearch",
    "LocalDrive",
    "OptimalDrive",
    "PositionDrive",
    "Ranking",
    "Search",
    "SecondScan",
    "Selection",
    "Target",
    "TrackingDrive",
    "TwoScans",
    "WithDriven",
    "arranged",
    "base_pattern",
    "best_fixed",
    "candidate_pairs",
    "candidate_pattern",
    "complete_pattern",
    "exchange",
    "greedy",
    "pair_currents",
    "pair_weights",
    "part_of",
    "position_bound",
    "round_robin",
]
