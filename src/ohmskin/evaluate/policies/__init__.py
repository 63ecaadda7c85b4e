"""Policies compared: what to measure next, by the paper, by position information, and by tracking.

    from ohmskin.evaluate import policies

    task = policies.Static("discs", decibels=40, seeds=20, schemes=("best", "16P"))
    print(policies.static_errors(task.run()).mean(axis=-1))

prints the mean errors (n_schemes, n_readers) in metres.
"""

import ohmskin.plot  # noqa: F401 (which says what to install if Matplotlib is missing)
from ohmskin.evaluate.flaws import Flaw
from ohmskin.evaluate.policies.comparison import compare
from ohmskin.evaluate.policies.goals import assess, static_errors
from ohmskin.evaluate.policies.pairs import PairDiscrimination, PairLimits
from ohmskin.evaluate.policies.plan import SECTIONS, Settings, plan
from ohmskin.evaluate.policies.static import Static
from ohmskin.evaluate.policies.tracked import Detection, Moving, Quiet, moving_errors
from ohmskin.evaluate.result import Outcome
from ohmskin.evaluate.setup import Setup, setup
from ohmskin.evaluate.verdict import Goal

__all__ = [
    "SECTIONS",
    "Detection",
    "Flaw",
    "Goal",
    "Moving",
    "Outcome",
    "PairDiscrimination",
    "PairLimits",
    "Quiet",
    "Settings",
    "Setup",
    "Static",
    "assess",
    "compare",
    "moving_errors",
    "plan",
    "setup",
    "static_errors",
]
