"""The adaptive loop: calibration, health, and keeping going."""

from ohmskin.engine.engine import Engine
from ohmskin.engine.health import Health
from ohmskin.engine.touch import State, Touch

__all__ = ["Engine", "Health", "State", "Touch"]
