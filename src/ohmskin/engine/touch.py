"""The outcome of one cycle, and the state of the loop."""

from dataclasses import dataclass
from enum import Enum

from ohmskin.contacts import Contact
from ohmskin.engine.health import Health
from ohmskin.gestures import Gesture, GestureState
from ohmskin.sensing import Percept
from ohmskin.skin import Mode


class State(Enum):
    """State of the loop."""

    CALIBRATING = "calibrating"  #: learning the quiet skin, or not calibrated yet
    RUNNING = "running"  #: scanning
    PAUSED = "paused"  #: not scanning, as was asked for
    LOST = "lost"  #: the device is gone; it is looked for


@dataclass(frozen=True)
class Touch:
    """The outcome of one cycle of the loop.

    Args:
        sequence: Number of the cycle.
        time: Time of the last sample on the host's monotonic clock (s).
        mode: The mode that was used.
        percept: Frames and images behind it.
        contacts: Contacts to report, strongest first.
        health: Rate, latency and losses.
        gestures: What the contacts do over time.
    """

    sequence: int
    time: float
    mode: Mode
    percept: Percept
    contacts: tuple[Contact, ...]
    health: Health
    gestures: GestureState

    @property
    def gesture(self) -> Gesture | None:
        """What the contacts do over time, classified when it is first asked for; None while nothing touches."""
        return self.gestures.gesture
