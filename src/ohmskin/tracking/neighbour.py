"""Tracking: contacts keep their id from frame to frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ohmskin.arrays import changed
from ohmskin.contacts.finder import Contact
from ohmskin.geometry.periodic import shortest


@dataclass(frozen=True)
class NeighbourTrack:
    """A contact followed over time: its newest sighting, how often it was seen and how often missed since."""

    contact: Contact
    seen: int = 1
    missed: int = 0


@dataclass(frozen=True)
class Tracks:
    """The state of a tracker. Start with ``Tracks()``.

    Args:
        tracks: The contacts that it follows.
        next_id: The id of the next new contact.
    """

    tracks: tuple[NeighbourTrack, ...] = ()
    next_id: int = 1


@dataclass(frozen=True)
class Tracker:
    """Tracks contacts by nearest neighbours.

    Args:
        period: Of a closed band, 0 of others (m).
        reach: Largest distance that a contact may move between two frames (m).
        confirm: Consecutive frames that must show a contact before it is reported; noise rarely repeats.
        patience: Frames without a contact after which its id is deleted. It is not reported meanwhile.
    """

    period: float = 0.0
    reach: float = 0.025
    confirm: int = 3
    patience: int = 3

    def update(self, state: Tracks, found: Sequence[Contact]) -> tuple[Tracks, tuple[Contact, ...]]:
        """The next state, and the contacts to report, with ids.

        Args:
            state: The state after the last frame.
            found: The contacts of this one; those reported are in their order.
        """
        old = state.tracks
        track_of: dict[int, int] = {}
        if old and found:
            last, now = (np.array([c.position for c in some]) for some in ([t.contact for t in old], found))
            distance = np.linalg.norm(shortest(last[:, None] - now[None], self.period), axis=2)
            assigned = zip(*linear_sum_assignment(np.minimum(distance, 2 * self.reach)), strict=True)
            track_of = {int(c): int(t) for t, c in assigned if distance[t, c] <= self.reach}
        next_id = state.next_id
        tracks, reported = [], []
        for number, contact in enumerate(found):
            if number in track_of:
                track = old[track_of[number]]
                track = NeighbourTrack(changed(contact, id=track.contact.id), track.seen + 1)
            else:
                track = NeighbourTrack(contact)
            if track.seen >= self.confirm:
                if track.contact.id < 0:
                    track = changed(track, contact=changed(contact, id=next_id))
                    next_id += 1
                reported.append(track.contact)
            tracks.append(track)
        for number, track in enumerate(old):
            if number not in track_of.values() and track.seen >= self.confirm and track.missed < self.patience:
                tracks.append(changed(track, missed=track.missed + 1))
        return Tracks(tuple(tracks), next_id), tuple(reported)
