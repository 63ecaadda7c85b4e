"""Which channels follow the model: estimated from many presses of unknown places, without labels.

Each press is taken for one contact at the place of the model's that explains it best; what the channels then measure
is held against what the model says they should. Gains and errors of the channels found so weigh the next search. A
channel without information ends with a small gain or a large error, one the other way round with a negative gain.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ohmskin.arrays import Bools, Floats
from ohmskin.errors import DataError
from ohmskin.scan import Channels, DrivePattern, Frame
from ohmskin.sensing import SkinModel
from ohmskin.skin import Calibration, Skin

_LEAST, _MOST = 30, 2000  # presses from which channels are judged; more add little
_FELT = 2.0  # times its noise by which a frame has changed that shows a press
_ROUNDS, _EVEN = 10, 2  # of the search, and of those the first with equal gains
_SPACING = 0.75  # usual radii of a contact between the places that are searched
_FLOOR = 0.02  # of the usual variance and power, added to each channel's: one alone must not decide
_SHAPED = 2.0  # parameters of a press beside its strength
_REPEATS = 4  # quiet frames from which the noise of each channel is estimated
_LEAST_NOISE = 1e-4  # of the largest voltage, as of a `SkinModel`
_NOISY = 3.0  # times the usual noise, above which a channel does not show whether there is a press


@dataclass(frozen=True, eq=False)
class ChannelJudgement:
    """Gains and errors of channels, estimated from presses.

    Args:
        pattern: Of the presses.
        channels: Gains and errors.
        places: (n, 2) estimated place of each press (m).
        unexplained: Share of the changes that one contact for each press does not explain, with weighted channels
            (median), and
        unexplained_before: the same with equal weights.
        skipped: Frames that show no press.
    """

    pattern: DrivePattern
    channels: Channels
    places: Floats
    unexplained: float
    unexplained_before: float
    skipped: int

    @property
    def doubtful(self) -> Bools:
        """(n_meas,) whether a channel carries little or no information."""
        return self.channels.doubtful(self.pattern)

    @property
    def reversed(self) -> Bools:
        """(n_meas,) whether a channel is inverted."""
        return np.asarray((self.channels.of(self.pattern)[0] < 0) & ~self.doubtful)

    def report(self) -> list[str]:
        """The findings as sentences, one a line."""
        doubtful, which = self.doubtful, self.pattern.measurements[:, 0]
        share = np.bincount(which, doubtful) / np.bincount(which)
        lines = [
            f"{len(self.places)} presses, {self.skipped} frames without one left out",
            f"{doubtful.sum()} of {len(doubtful)} channels carry little or no information, "
            f"{self.reversed.sum()} have the wrong sign",
            f"one contact each leaves {100 * self.unexplained:.0f} % unexplained; "
            f"{100 * self.unexplained_before:.0f} % with all channels alike",
        ]
        for injection in np.flatnonzero(share > 0.5):
            source, sink = self.pattern.injections[injection]
            lines.append(
                f"injection {source} to {sink}: {100 * share[injection]:.0f} % of its channels: little information"
            )
        return lines

    def put_into(self, calibration: Calibration, resistances: Floats | None = None) -> Calibration:
        """The same calibration with these channels, and their `resistances` (n,) on the untouched skin (ohm), NaN
        where they were not measured."""
        quadruples = tuple(tuple(row) for row in self.channels.quadruples.tolist())
        gains, errors = (tuple(np.round(one, 5).tolist()) for one in (self.channels.gains, self.channels.errors))
        known = np.nan_to_num(np.empty(0) if resistances is None else resistances)
        return replace(
            calibration,
            channels=quadruples,
            channel_gains=gains,
            channel_errors=errors,
            channel_resistances=tuple(float(f"{one:.7g}") for one in known),
        )


def judge_channels(
    skin: Skin, quiet: Sequence[Frame], frames: Sequence[Frame], progress: Callable[[float], None] = lambda _: None
) -> ChannelJudgement:
    """Estimate gains and errors of a pattern's channels from frames of one press each, spread as evenly as possible.

    Args:
        skin: Its description; gains and errors in it are not used.
        quiet: Frames of the untouched skin.
        frames: Frames of presses, all of one pattern.
        progress: Called with the share done, 0 to 1.

    Raises:
        DataError: If there are several patterns, or too few frames that show a press.
        ModelError: If the sheet is not flat.
    """
    if len(patterns := {frame.pattern for frame in frames}) != 1:
        raise DataError(f"the presses have {len(patterns)} drive patterns; channels are judged for one at a time")
    (pattern,) = patterns
    bare = replace(
        skin.calibration, channels=(), channel_gains=(), channel_errors=(), channel_resistances=(), position_map=""
    )
    known = SkinModel(replace(skin, calibration=bare), skin.transfer_model(), quiet)
    differences = [known.difference(frame) for frame in frames]
    ohms = np.array([change.volts / change.currents for change in differences])
    volts = np.array([change.volts for change in differences])
    noise = _noise(pattern, quiet, known.noise)
    steady = noise < _NOISY * np.median(noise)
    size = _rms(volts[:, steady])
    felt = np.flatnonzero(size > _FELT * _rms(noise[None, steady]))
    if len(felt) < _LEAST:
        told = f"{len(felt)} of {len(frames)} frames change by more than {_FELT:g} times the noise"
        raise DataError(
            f"{told}; to judge channels, press the skin at {_LEAST} places or more, or leave that out (--no-channels)"
        )
    skipped, felt = len(frames) - len(felt), felt[:: -(-len(felt) // _MOST)]
    ohms = ohms[felt]
    measured = np.isfinite(ohms) & np.nan_to_num(ohms).any(axis=0)  # what never changes is not measured
    ohms = np.where(measured, ohms, 0.0)
    table = known.fitter.table
    chosen = table.spaced(_SPACING * table.radius)
    search = _Search(
        table(table.places[chosen]).values @ pattern.combination(table.pairs).T,
        ohms,
        measured,
        noise / np.median(size[felt]),
    )
    before = search.unexplained
    for number in range(_ROUNDS):
        search.improve(gains=number >= _EVEN)
        progress((number + 1) / _ROUNDS)
    gains = np.where(measured.any(axis=0), search.gains, 0.0)  # of what was never measured nothing is known
    found = Channels(pattern.quadruples, gains, search.errors)
    return ChannelJudgement(pattern, found, table.places[chosen][search.best], search.unexplained, before, skipped)


def _noise(pattern: DrivePattern, quiet: Sequence[Frame], usual: float) -> Floats:
    """Standard deviation (n_meas,) of each channel's change (V); `usual` where quiet frames are too few."""
    repeats = [frame.voltages for frame in quiet if frame.pattern == pattern]
    if len(repeats) < _REPEATS:
        return np.full(pattern.n_meas, usual)
    scatter = np.std(repeats, axis=0, ddof=1) * np.sqrt(1 + 1 / len(repeats))
    least = _LEAST_NOISE * float(np.nanmax(np.abs(repeats[0])))
    return np.asarray(np.maximum(np.where(np.isfinite(scatter), scatter, usual), least))


def _rms(volts: Floats) -> Floats:
    """Root mean square (n,) of what is known of each row (n, n_meas)."""
    known = np.isfinite(volts)
    return np.asarray(np.sqrt((np.where(known, volts, 0.0) ** 2).sum(axis=1) / np.maximum(known.sum(axis=1), 1)))


class _Search:
    """The place of each press, and the gains and errors of the channels, in turns.

    Args:
        templates: (n_places, n_meas) what a contact changes of each channel.
        changes: (n_presses, n_meas) what was measured, and
        measured: whether it was.
        noise: (n_meas,) of each channel, over the size of a usual press.
    """

    def __init__(self, templates: Floats, changes: Floats, measured: Bools, noise: Floats) -> None:
        self._templates, self._changes, self._measured = templates, changes, measured.astype(float)
        self.gains, self.errors = np.ones(templates.shape[1]), np.sqrt(1 + noise**2)
        raised, lowered = (self._explained(sign)[0].sum() for sign in (1.0, -1.0))
        self.gains *= 1.0 if raised >= lowered else -1.0  # all the other way round
        self._explain()

    def _explained(self, sign: float) -> tuple[Floats, Floats, Floats]:
        """Of each press the best place's squared data explained (n,), its strength (n,) and number (n,)."""
        templates, precision = sign * self.gains * self._templates, self.errors**-2.0
        score = self._changes * precision @ templates.T
        power = np.maximum(self._measured * precision @ (templates**2).T, 1e-300)
        gain = np.maximum(score, 0.0) ** 2 / power
        best = gain.argmax(axis=1)
        rows = np.arange(len(best))
        return gain[rows, best], np.maximum(score[rows, best], 0.0) / power[rows, best], best

    def _explain(self) -> None:
        explained, strength, self.best = self._explained(1.0)
        whole = self._measured * self._changes**2 @ self.errors**-2.0
        self.unexplained = float(np.median(1 - explained / np.maximum(whole, 1e-300)))
        self._caused = strength[:, None] * self._templates[self.best] * self._measured
        precision = self._measured * self.errors**-2.0
        weighed = precision * (self.gains * self._caused) ** 2
        power = weighed.sum(axis=1, keepdims=True)
        self._size = np.sqrt(power[:, 0] / precision.sum(axis=1))
        self._leverage = np.minimum(_SHAPED * np.mean(weighed / np.maximum(power, 1e-300), axis=0), 0.8)

    def improve(self, gains: bool) -> None:
        """Errors of the channels, and gains if asked for, as the presses are now explained; then those anew."""
        scale = np.divide(1.0, self._size, out=np.zeros_like(self._size), where=self._size > 0)[:, None]
        caused, changes = scale * self._caused, scale * self._changes
        if gains:
            power = (caused**2).sum(axis=0)
            least = _FLOOR * power.mean()
            usual = np.sign(self.gains.sum())
            self.gains = ((caused * changes).sum(axis=0) + usual * least) / (power + least)
            self.gains /= np.median(np.abs(self.gains))
        left = self._measured * (changes - self.gains * caused) ** 2
        variance = left.sum(axis=0) / np.maximum(self._measured.sum(axis=0), 1.0) / (1 - self._leverage)
        self.errors = np.sqrt(variance + _FLOOR * np.median(variance))
        self._explain()
