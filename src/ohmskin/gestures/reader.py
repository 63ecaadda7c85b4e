"""Classifies gestures of contacts as they come."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

from ohmskin.gestures.episode import ContactLike, Episode
from ohmskin.gestures.model import UNKNOWN, GestureModel

_APART = 0.2  # s without a contact, after which an episode has ended
_SHOWN = 0.5  # s for which an ended gesture is still reported


@dataclass(frozen=True)
class Gesture:
    """Class of an episode.

    Args:
        name: One of `GESTURES`, or ``unknown``: uncertain (yet), or unlike all of them.
        confidence: Probability of the most probable gesture (0 to 1); 0 if the episode is unlike all of them.
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
    """The present or last episode, and its gesture.

    Args:
        episode: The episode; None before anything touched.
        model: The classifier.
        shown: Whether its gesture is still reported.
    """

    episode: Episode | None = None
    model: GestureModel | None = field(default=None, repr=False)
    shown: bool = False

    @cached_property
    def gesture(self) -> Gesture | None:
        """The gesture, classified when it is first asked for; None where nothing has touched for half a second."""
        if self.episode is None or self.model is None or not self.shown:
            return None
        name, confidence = self.model.classify(self.episode.features)
        return Gesture(name, confidence, self.episode.began, self.episode.duration, self.episode.ended)


class GestureReader:
    """Classifies contacts over time as taps, strokes, pushes and grasps; state in, state out.

    Contacts are of any mode, on the sheet (`ohmskin.contacts.Contact`) or in a robot's frame
    (`ohmskin.client.Contact`): only place and strength are used.

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
        episode = state.episode
        if episode is not None and time < episode.last:  # a recording that was wound back
            episode = None
        if contacts:
            if episode is None or episode.ended or time - episode.last > _APART:
                episode = Episode(began=time, last=time)
            return GestureState(episode.after(time, contacts), self.model, shown=True)
        if episode is None:
            return self.start()
        if not episode.ended and time - episode.last > _APART:
            episode = replace(episode, ended=True)
        return GestureState(episode, self.model, not episode.ended or time - episode.last <= _APART + _SHOWN)


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
        return self.after(time, contacts).gesture

    def after(self, time: float, contacts: Sequence[ContactLike]) -> GestureState:
        """The state after one more frame, at a `time` (s), with `contacts`, which may be empty."""
        self._state = self._reader.update(self._state, time, contacts)
        return self._state
