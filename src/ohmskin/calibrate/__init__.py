"""Self-test of wiring and instrument; calibration of a skin to its quiet state, to newtons and to places."""

from ohmskin.calibrate.channels import ChannelJudgement, judge_channels
from ohmskin.calibrate.force import ForceCurve, PressSample, fit_auxiliary, fit_force
from ohmskin.calibrate.instrumented import ForceSampler, LoadCell, read_table
from ohmskin.calibrate.newtons import fit_newtons
from ohmskin.calibrate.positions import PositionReport, learn_positions, read_places
from ohmskin.calibrate.presses import GRAVITY, PressGuide, PressStep, press_plan
from ohmskin.calibrate.quiet import calibrate_quiet, skin_as_measured
from ohmskin.calibrate.self_test import SelfTest, self_test
from ohmskin.calibrate.sheet import SheetFit, fit_sheet
from ohmskin.calibrate.wiring import WiringDiagnosis, WiringFinding, diagnose, terminal_pattern

__all__ = [
    "GRAVITY",
    "ChannelJudgement",
    "ForceCurve",
    "ForceSampler",
    "LoadCell",
    "PositionReport",
    "PressGuide",
    "PressSample",
    "PressStep",
    "SelfTest",
    "SheetFit",
    "WiringDiagnosis",
    "WiringFinding",
    "calibrate_quiet",
    "diagnose",
    "fit_auxiliary",
    "fit_force",
    "fit_newtons",
    "fit_sheet",
    "judge_channels",
    "learn_positions",
    "press_plan",
    "read_places",
    "read_table",
    "self_test",
    "skin_as_measured",
    "terminal_pattern",
]
