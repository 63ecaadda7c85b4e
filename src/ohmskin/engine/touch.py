"""What the loop tells of one cycle, and what it is doing."""

from dataclasses import dataclass
from enum import Enum

from ohmskin.contacts import Contact
from ohmskin.engine.health import Health
from ohmskin.sensing import Percept
from ohmskin.skin import Mode


class State(Enum):
    """What the loop is doing."""

    CALIBRATING = "calibrating"
    RUNNING = "running"
    PAUSED = "paused"
    LOST = "lost"


@dataclass(frozen=True)
class Touch:
    """What the skin feels now: the outcome of one cycle.

    Args:
        sequence: Number of the cycle.
        time: Time of the last sample on the host's monotonic clock (s).
        mode: The mode it was made in.
        percept: Frames and images behind it.
        contacts: Contacts to report, strongest first.
        health: How the loop is doing.
    """

    sequence: int
    time: float
    mode: Mode
    percept: Percept
    contacts: tuple[Contact, ...]
    health: Health
