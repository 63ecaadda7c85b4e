"""Classifies gestures of contacts as they come."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from ohmskin.gestures.episode import ContactLike, Episode
from ohmskin.gestures.model import UNKNOWN, GestureModel

_APART = 0.2  # s without a contact, after which an episode has ended
_SHOWN = 0.5  # s for which an ended gesture is still told


@dataclass(frozen=True)
class Gesture:
    """Class of an episode.

    Args:
        name: One of `GESTURES`, or ``unknown``: not sure (yet), or unlike all of them.
        confidence: Probability of the gesture that is likeliest (0 to 1); 0 if the episode is unlike all of them.
        began: When it began (s).
        duration: How long it has lasted (s).
        ended: Whether all contacts are lifted, so that it is final.
    """

    name: str = UNKNOWN
    confidence: float = 0.0
    began: float = 0.0
    duration: float = 0.0
    ended: bool = False

    def as_json(self) -> dict[str, Any]:
        """Its attributes by name."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class GestureState:
    """The episode that is under way, or the last one, and its gesture."""

    episode: Episode | None = None
    gesture: Gesture | None = None


class GestureReader:
    """Classifies contacts over time as taps, strokes, pushes and grasps; state in, state out.

    Contacts are of any mode, on the sheet (`ohmskin.contacts.Contact`) or in a robot's frame
    (`ohmskin.client.Contact`): place and strength are all that counts.

    Args:
        model: The classifier; the one that ships unless given.
    """

    def __init__(self, model: GestureModel | None = None) -> None:
        self.model = model or GestureModel.load()

    def start(self) -> GestureState:
        """The state before anything touches."""
        return GestureState()

    def update(self, state: GestureState, time: float, contacts: Sequence[ContactLike]) -> GestureState:
        """The state after one more frame; its gesture is None where nothing has touched for half a second.

        Args:
            state: The state after the last one.
            time: When the frame was taken (s).
            contacts: The contacts of the frame; may be empty.
        """
        episode, gesture = state.episode, state.gesture
        if episode is not None and time < episode.last:  # a recording that was wound back
            episode = gesture = None
        if contacts:
            if episode is None or episode.ended or time - episode.last > _APART:
                episode = Episode(began=time, last=time)
            episode = episode.after(time, contacts)
            return GestureState(episode, self._classified(episode))
        if episode is None:
            return state
        if not episode.ended and time - episode.last > _APART:
            episode = replace(episode, ended=True)
            gesture = self._classified(episode)
        shown = gesture if not episode.ended or time - episode.last <= _APART + _SHOWN else None
        return GestureState(episode, shown)

    def _classified(self, episode: Episode) -> Gesture:
        name, confidence = self.model.classify(episode.features)
        return Gesture(name, confidence, episode.began, episode.duration, episode.ended)


class GestureFollower:
    """A `GestureReader` that keeps its state: call it with the time (s) and the contacts of every frame.

    Args:
        model: The classifier; the one that ships unless given.
    """

    def __init__(self, model: GestureModel | None = None) -> None:
        self._reader = GestureReader(model)
        self._state = self._reader.start()

    def __call__(self, time: float, contacts: Sequence[ContactLike]) -> Gesture | None:
        """What the contacts do after one more frame; None where nothing has touched for half a second.

        Args:
            time: When the frame was taken (s).
            contacts: The contacts of the frame; may be empty.
        """
        self._state = self._reader.update(self._state, time, contacts)
        return self._state.gesture
