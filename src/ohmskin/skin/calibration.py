"""What was measured of one particular skin, kept in its description: the table ``[calibration]``."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ohmskin.arrays import Floats
from ohmskin.errors import SkinError
from ohmskin.geometry import Domain
from ohmskin.scan import Channels, DrivePattern
from ohmskin.skin.checks import check_table, number, numbers, places, rows
from ohmskin.skin.positions import PositionMap


@dataclass(frozen=True)
class Calibration:
    """A calibration; without a date the skin is not calibrated.

    Args:
        date: When it was made, UTC, in ISO form.
        version: Of ohmskin, when it was made.
        made_for: `Skin.digest` of its skin.
        mode: Mode in which the strengths were measured.
        conductivity: Fitted sheet conductivity (S per square).
        positions: (n_elec, 2) fitted places of the electrodes (m); as described unless given.
        log_conductivity: (n_waves^2,) coefficients of `forward.conductivity.cosines`, a field of the logarithm of the
            conductivity; uniform unless given.
        contact_impedances: (n_elec,) of the electrodes (ohm); as described unless given.
        unexplained: Root mean square residual of four-terminal resistances, as a share of theirs: as described, and
            with fitted positions and conductivity.
        contact_resistance: Median series resistance at an electrode beyond the described (ohm); 0 if too small.
        misfit: Root mean square of measured less modelled pair resistances, as a share of the resistance.
        noise: Standard deviation of a voltage (V).
        drift: Standard deviation of a quiet voltage after a second, growing with the root of time (V / s^0.5).
        pair_resistances: (n_pairs,) two-terminal resistances of the quiet skin (ohm).
        strengths: Rising `Contact.strength` (m2) at which `forces` are known.
        forces: Rising forces (N).
        force_error: Root mean square error of the force over the presses of the calibration (N).
        hysteresis: Largest difference of strength between loading and unloading, as a share of the largest strength.
        layer_conductance: Of the contact layer, per area at its pressure scale (S/m2), and
        layer_exponent: of its growth with pressure (1), as presses of known force showed them; 0: as described.
        layer_stds: Standard deviations of that conductance's logarithm, and of that exponent.
        layer_error: Error of forces under it beyond what is known of each, from those presses: standard deviation of
            the logarithm (1).
        layer_hysteresis: Its `ContactLayer.hysteresis`, from presses with falling force (1); below 0: as described.
        auxiliary_gain, auxiliary_error: Of the `Auxiliary` channel (N/N or Pa/N), and of the gain as a share (1), as
            presses of known force showed it; 0: as described.
        channels: (n, 4) source, sink, plus, minus of the channels judged from presses, and
        channel_gains, channel_errors: how each follows the model, see `ohmskin.scan.Channels`.
        channel_resistances: (n,) of these channels on the untouched skin (ohm), 0 where they were not measured.
        position_map: Correction of positions, learned from presses at known places: a `PositionMap` as text.

    Raises:
        SkinError: If an entry is out of range, or lists that belong together do not fit.
    """

    date: str = ""
    version: str = ""
    made_for: str = ""
    mode: str = ""
    conductivity: float = number(0.0, 0, 1e6, "S per square")
    positions: tuple[tuple[float, float], ...] = ()
    log_conductivity: tuple[float, ...] = numbers(10, "", -10)
    contact_impedances: tuple[float, ...] = numbers(1e9, "ohm")
    unexplained: tuple[float, ...] = numbers(1e3)
    contact_resistance: float = number(0.0, 0, 1e9, "ohm")
    misfit: float = number(0.0, 0, 1e3, "")
    noise: float = number(0.0, 0, 1e3, "V")
    drift: float = number(0.0, 0, 1e3, "V / s^0.5")
    pair_resistances: tuple[float, ...] = numbers(1e12, "ohm")
    strengths: tuple[float, ...] = numbers(1e3, "m2")
    forces: tuple[float, ...] = numbers(1e6, "N")
    force_error: float = number(0.0, 0, 1e6, "N")
    hysteresis: float = number(0.0, 0, 1e3, "")
    layer_conductance: float = number(0.0, 0, 1e9, "S/m2")
    layer_exponent: float = number(0.0, 0, 3, "")
    layer_stds: tuple[float, ...] = numbers(1e3)
    layer_error: float = number(0.0, 0, 10, "")
    layer_hysteresis: float = number(-1.0, -1, 0.5, "")
    auxiliary_gain: float = number(0.0, 0, 1e9, "N/N or Pa/N")
    auxiliary_error: float = number(0.0, 0, 1, "")
    channels: tuple[tuple[int, int, int, int], ...] = rows("[source, sink, plus, minus]")
    channel_gains: tuple[float, ...] = numbers(1e3, low=-1e3)
    channel_errors: tuple[float, ...] = numbers(1e3, low=1e-6)
    channel_resistances: tuple[float, ...] = numbers(1e12, "ohm", -1e12)
    position_map: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", places(self.channels))
        object.__setattr__(self, "positions", places(self.positions))
        check_table("calibration", self)
        if len(self.log_conductivity) != round(len(self.log_conductivity) ** 0.5) ** 2:
            raise SkinError(f"calibration.log_conductivity has {len(self.log_conductivity)} entries; 36, or a square")
        if len(self.strengths) != len(self.forces) or len(self.strengths) == 1:
            counts = f"{len(self.strengths)} strengths and {len(self.forces)} forces"
            raise SkinError(f"calibration has {counts}; as many of both, two or more")
        if len(self.layer_stds) not in (0, 2):
            raise SkinError(f"calibration.layer_stds has {len(self.layer_stds)} entries; it must have 2, or none")
        if not len(self.channels) == len(self.channel_gains) == len(self.channel_errors):
            counts = f"{len(self.channels)}, {len(self.channel_gains)} and {len(self.channel_errors)} entries"
            raise SkinError(f"calibration.channels, channel_gains and channel_errors have {counts}; as many of each")
        if len(self.channel_resistances) not in (0, len(self.channels)):
            counts = f"{len(self.channel_resistances)} entries for {len(self.channels)} channels"
            raise SkinError(f"calibration.channel_resistances has {counts}; one of each, or none")
        for name, values in (("strengths", self.strengths), ("forces", self.forces)):
            if any(b <= a for a, b in pairwise(values)):
                raise SkinError(f"calibration.{name} must rise from each to the next; they are {list(values)}")

    def made_now(self, digest: str, version: str) -> "Calibration":
        """The same, as of now, for the skin with this digest; `version` is that of ohmskin."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return replace(self, date=now, version=version, made_for=digest)

    @property
    def tells_force(self) -> bool:
        """Whether forces were calibrated."""
        return bool(self.layer_conductance or self.forces)

    @property
    def judged(self) -> Channels | None:
        """Gains and errors of its channels; None if they were never judged."""
        if not self.channels:
            return None
        return Channels(np.array(self.channels), np.array(self.channel_gains), np.array(self.channel_errors))

    def resting(self, pattern: DrivePattern) -> Floats:
        """Resistances (n_meas,) of the channels of a `pattern` on the untouched skin whose presses were learned (ohm);
        NaN where they are not known."""
        found = np.full(pattern.n_meas, np.nan)
        if self.channel_resistances and (judged := self.judged) is not None:
            at, signs, known = judged.find(pattern)
            then = np.array(self.channel_resistances)[at]
            found = np.where(known & (then != 0), signs * then, np.nan)
        return found

    @property
    def positions_learned(self) -> PositionMap | None:
        """The learned map of positions; None if there is none."""
        return PositionMap.parse(self.position_map) if self.position_map else None

    def check(self, domain: Domain, n_elec: int) -> None:
        """Check that the calibration fits its skin.

        Args:
            domain: The skin's map.
            n_elec: Number of its electrodes.

        Raises:
            SkinError: If it does not fit.
        """
        for name, given in (("positions", self.positions), ("contact_impedances", self.contact_impedances)):
            if given and len(given) != n_elec:
                raise SkinError(f"calibration.{name} has {len(given)} entries for {n_elec} electrodes; calibrate again")
        if (learned := self.positions_learned) is not None and learned.quadruples.max() >= n_elec:
            raise SkinError(f"calibration.position_map has electrodes beyond {n_elec - 1}; learn it again")
        if self.channels and not {e for channel in self.channels for e in channel} <= set(range(n_elec)):
            raise SkinError(f"calibration.channels names an electrode that is not 0 to {n_elec - 1}; calibrate again")
        if self.positions and not (domain.depth(self.positions) > -1e-6).all():
            raise SkinError("calibration.positions has electrodes off the sheet; calibrate again")

    def force(self, strength: ArrayLike) -> NDArray[np.float64]:
        """The force (N) of contacts of some `strength` (m2), any shape: a monotone curve through what was measured.

        Strength 0 gives force 0. Above the strongest press of the calibration it is the force of that press, a lower
        bound.

        Raises:
            SkinError: If no force was calibrated.
        """
        if not self.forces:
            raise SkinError("this skin is not calibrated to newtons; run `ohmskin calibrate` and load its file")
        from scipy.interpolate import PchipInterpolator  # takes a third of a second, which few skins need to wait

        nothing = [0.0] if self.strengths[0] > 0 else []
        known, newtons = np.array([*nothing, *self.strengths]), np.array([*nothing, *self.forces])
        clipped = np.clip(np.asarray(strength, float), known[0], known[-1])
        return np.asarray(PchipInterpolator(known, newtons)(clipped), float)
