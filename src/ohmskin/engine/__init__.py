"""The adaptive loop: perception, health, and keeping going."""

from ohmskin.engine.engine import Engine, State, Touch
from ohmskin.engine.health import Health
from ohmskin.engine.perception import Perception, Sight, Thresholds

__all__ = ["Engine", "Health", "Perception", "Sight", "State", "Thresholds", "Touch"]
