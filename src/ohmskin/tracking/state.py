"""Track state: what is believed to touch the skin, from one frame to the next."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ohmskin.arrays import Floats, Ints, changed
from ohmskin.contacts.finder import Contact
from ohmskin.contacts.solution import PER_CONTACT, effect_std
from ohmskin.contacts.uneven import UnevenDrift
from ohmskin.scan import Difference, newest
from ohmskin.tracking.residuals import Residuals

STATE = 6  # x, y, effect, squared radius, velocity


@dataclass(frozen=True)
class Track:
    """What is remembered of a contact beside its state.

    Args:
        id: Its name.
        peak: Its largest effect so far (m2).
        since: When it came (s).
        lifted: Since when it is lifted (s); zero while it presses.
        refuted: Gain expected of two in its place when they were last fitted without success (1).
    """

    id: int
    peak: float
    since: float
    lifted: float = 0.0
    refuted: float = 0.0


@dataclass(frozen=True, eq=False)
class TrackState:
    """Contacts that are tracked, with their uncertainty. Start with ``ContactFilter.start()``.

    Args:
        tracks: The contacts in the order in which they came, lifted ones included.
        mean: (n, 6) x, y (m), effect (m2), squared radius (m2) and velocity (m/s) of each.
        covariance: (6 n, 6 n) of all of them together.
        common_drift: Common relative change of all resistances since the calibration, and its variance (1).
        drift: (n_pairs,) other changes of the baseline: two-terminal resistances (ohm).
        uneven: How unevenly the sheet drifts.
        degraded_errors: (n_pairs, k) what it may be off by because of `degraded` contacts, each for one standard
            deviation (ohm).
        contacts: The contacts to report, strongest first.
        next_id: The id of the next contact.
        turn: Frames so far.
        time: Since the start (s).
        newest_energy: Squared size of what contacts cause of the newest frame, over the noise's variance (1).
        kept_signal: Size of what foam and learned drift may keep of contacts, over the noise (1).
        history: The last frames, newest first.
        unexplained: Share of the newest frame's data that the contacts do not explain.
        suspects: Electrodes that alone showed a contact in the newest frame.
        covered: Electrodes under contacts, whose resistance is treated as unknown, see `Solution`.
        refuted: Residual over the usual one when others were last searched without success (1); 0: the contacts
            explained the last frames at the last revision; below 1: they did not, for the first time.
        degraded: Electrodes whose contacts degraded within the last second.
        doubted: Until when contacts are doubted because of these (s).
        doubted_frames: Newest frames in a row that showed contacts that explain them poorly.
        possible: Number of the place where one more contact may be; -1: none may.
    """

    tracks: tuple[Track, ...]
    mean: Floats
    covariance: Floats = field(repr=False)
    common_drift: tuple[float, float]
    drift: Floats = field(repr=False)
    uneven: UnevenDrift = field(repr=False)
    degraded_errors: Floats = field(repr=False)
    contacts: tuple[Contact, ...] = ()
    next_id: int = 1
    turn: int = 0
    time: float = 0.0
    newest_energy: float = 0.0
    kept_signal: float = 0.0
    history: tuple[Residuals, ...] = field(default=(), repr=False)
    unexplained: float = 0.0
    suspects: tuple[int, ...] = ()
    covered: tuple[int, ...] = ()
    refuted: float = 0.0
    degraded: tuple[int, ...] = ()
    doubted: float = 0.0
    doubted_frames: int = 0
    possible: int = -1

    def recent(self, injections: int) -> tuple[Difference, ...]:
        """The newest frames with at least this number of injections together, without drift and temperature, newest
        first."""
        return newest((), (residuals.observation.difference for residuals in self.history), injections)

    @property
    def params(self) -> Floats:
        """(n, 4) x, y (m), effect (m2), squared radius (m2) of each contact."""
        return self.mean[:, :PER_CONTACT]

    @property
    def measured(self) -> Ints:
        """Indices (4 n,), in the state of all contacts, of the parameters on which a frame depends."""
        return (np.arange(len(self.tracks))[:, None] * STATE + np.arange(PER_CONTACT)).ravel()

    @property
    def pressing(self) -> list[int]:
        """The numbers of the contacts that are not lifted."""
        return [k for k, track in enumerate(self.tracks) if not track.lifted]

    def covariance_of(self, k: int) -> Floats:
        """Of the parameters of contact number `k` (4, 4)."""
        at = slice(STATE * k, STATE * k + PER_CONTACT)
        return self.covariance[at, at]

    def effect(self, k: int) -> tuple[float, float]:
        """The size of the effect of contact number `k`, and its standard deviation (m2)."""
        return abs(float(self.mean[k, 2])), effect_std(self.covariance_of(k))

    def with_contact(self, params: Floats, covariance: Floats, speed: float, name: int | None = None) -> "TrackState":
        """The state with one more contact, at rest.

        Args:
            params: (4,) its parameters.
            covariance: (4, 4) of them.
            speed: Standard deviation of its velocity (m/s).
            name: Its id, the next one unless given.
        """
        known, end = STATE * len(self.tracks), STATE * len(self.tracks) + PER_CONTACT
        whole = np.zeros((known + STATE, known + STATE))
        whole[:known, :known] = self.covariance
        whole[known:end, known:end] = covariance
        whole[[-2, -1], [-2, -1]] = speed**2
        track = Track(self.next_id if name is None else name, abs(float(params[2])), self.time)
        mean = np.vstack([self.mean, [*params, 0.0, 0.0]])
        next_id = self.next_id + (name is None)
        return changed(self, tracks=(*self.tracks, track), mean=mean, covariance=whole, next_id=next_id)

    def without(self, gone: Sequence[int]) -> "TrackState":
        """The state without the contacts whose numbers are in `gone`."""
        if not gone:
            return self
        kept = np.array([k for k in range(len(self.tracks)) if k not in gone], int)
        state = (kept[:, None] * STATE + np.arange(STATE)).ravel()
        tracks = tuple(self.tracks[k] for k in kept)
        return changed(self, tracks=tracks, mean=self.mean[kept], covariance=self.covariance[np.ix_(state, state)])
