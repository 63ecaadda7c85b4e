"""From a mode to contacts: a sensor is a drive and a reader, with the model of a quiet skin."""

from ohmskin.sensing.build import READERS, build, check_parts, drive_of, perceive
from ohmskin.sensing.compiled import CompiledCycle
from ohmskin.sensing.diagnosis import Cause, Diagnosis, Finding
from ohmskin.sensing.layer_fit import FittedLayer, KnownPress, fit_layer
from ohmskin.sensing.learned import LearnedReader
from ohmskin.sensing.model import SkinModel
from ohmskin.sensing.modes import DEFAULT, MODES, RECORDED, default_mode, mode_named, modes, recorded_mode
from ohmskin.sensing.presses import FittedPress, PressFitter
from ohmskin.sensing.readers import Belief, DetectionReader, FilterReader, FitReader, Reader
from ohmskin.sensing.sensor import Percept, Scan, Sensor, SensorState, Thresholds

__all__ = [
    "DEFAULT",
    "MODES",
    "READERS",
    "RECORDED",
    "Belief",
    "Cause",
    "CompiledCycle",
    "DetectionReader",
    "Diagnosis",
    "FilterReader",
    "Finding",
    "FitReader",
    "FittedLayer",
    "FittedPress",
    "KnownPress",
    "LearnedReader",
    "Percept",
    "PressFitter",
    "Reader",
    "Scan",
    "Sensor",
    "SensorState",
    "SkinModel",
    "Thresholds",
    "build",
    "check_parts",
    "default_mode",
    "drive_of",
    "fit_layer",
    "mode_named",
    "modes",
    "perceive",
    "recorded_mode",
]
