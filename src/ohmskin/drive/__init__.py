"""What to drive next: the paper's modes and its adaptive choice."""

from ohmskin.drive.local import LocalDrive
from ohmskin.drive.modes import AdaptiveDrive, Mode, mode, modes
from ohmskin.drive.optimal import OptimalDrive, pair_weights, take_turns

__all__ = ["AdaptiveDrive", "LocalDrive", "Mode", "OptimalDrive", "mode", "modes", "pair_weights", "take_turns"]
