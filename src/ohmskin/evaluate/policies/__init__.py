"""Policies compared: what to measure next, by the paper, by position information, and with a memory.

from ohmskin.evaluate import policies

task = policies.Static("discs", decibels=40, seeds=20, schemes=("16O", "16P"))
print(policies.static_errors(task.run()).mean(axis=-1))  # (n_schemes, n_estimators), metres
"""

from ohmskin.evaluate.policies.comparison import Comparison, compare
from ohmskin.evaluate.policies.detection import Detection, Quiet
from ohmskin.evaluate.policies.goals import Goal
from ohmskin.evaluate.policies.judge import judge, moving_errors, static_errors
from ohmskin.evaluate.policies.lab import Flaw, Lab, lab
from ohmskin.evaluate.policies.moving import Moving
from ohmskin.evaluate.policies.pairs import PairLimits, Pairs
from ohmskin.evaluate.policies.plan import SECTIONS, Settings, plan
from ohmskin.evaluate.policies.static import Static

__all__ = [
    "SECTIONS",
    "Comparison",
    "Detection",
    "Flaw",
    "Goal",
    "Lab",
    "Moving",
    "PairLimits",
    "Pairs",
    "Quiet",
    "Settings",
    "Static",
    "compare",
    "judge",
    "lab",
    "moving_errors",
    "plan",
    "static_errors",
]
