"""What to drive next: the paper's modes and its adaptive choice; policies that choose by what is not yet known."""

from ohmskin.drive.bound import ContactPrior, best_fixed, position_bound
from ohmskin.drive.design import Candidates, Choice, Search, exchange, greedy, pair_currents
from ohmskin.drive.informed import InformedPolicy, Plan, PositionDrive, Ranking
from ohmskin.drive.layout import LayoutSearch, arranged
from ohmskin.drive.local import LocalDrive
from ohmskin.drive.modes import AdaptiveDrive, Mode, mode, modes
from ohmskin.drive.optimal import OptimalDrive, pair_weights, part_of, take_turns
from ohmskin.drive.policy import Exploration, Policy, Target, base_pattern, complete_pattern

__all__ = [
    "AdaptiveDrive",
    "Candidates",
    "Choice",
    "ContactPrior",
    "Exploration",
    "InformedPolicy",
    "LayoutSearch",
    "LocalDrive",
    "Mode",
    "OptimalDrive",
    "Plan",
    "Policy",
    "PositionDrive",
    "Ranking",
    "Search",
    "Target",
    "arranged",
    "base_pattern",
    "best_fixed",
    "complete_pattern",
    "exchange",
    "greedy",
    "mode",
    "modes",
    "pair_currents",
    "pair_weights",
    "part_of",
    "position_bound",
    "take_turns",
]
