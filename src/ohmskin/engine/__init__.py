"""The adaptive loop: calibration, cycles, health, and reconnection to lost devices."""

from ohmskin.engine.engine import Engine
from ohmskin.engine.health import Health
from ohmskin.engine.touch import State, Touch

__all__ = ["Engine", "Health", "State", "Touch"]
