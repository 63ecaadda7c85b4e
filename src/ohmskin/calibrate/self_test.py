"""The self-test of a skin: the connection of every electrode, and the figures of the instrument."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial

import numpy as np

from ohmskin.arrays import as_plain
from ohmskin.calibrate import measures
from ohmskin.calibrate.wiring import WiringDiagnosis, WiringFinding, diagnose, terminal_pattern
from ohmskin.device import Device
from ohmskin.errors import DeviceError
from ohmskin.scan.quality import in_words
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin

_REPEATS = 12
_LOUD = 3.0  # times the described noise above which the measured one is a finding
_BENT = 0.02  # share of the signal that linearity may miss


@dataclass(frozen=True, eq=False)
class SelfTest:
    """Result of the self-test. All but the diagnosis are None if too few electrodes are connected to measure them.

    Args:
        skin: Name of the skin's description.
        device: Name of the device.
        date: When, UTC, in ISO form.
        diagnosis: Wiring and sheet.
        noise, offset, linearity, settling, link, rates: The measurements of the instrument.
    """

    skin: str
    device: str
    date: str
    diagnosis: WiringDiagnosis
    noise: measures.Noise | None = None
    offset: measures.Offset | None = None
    linearity: measures.Linearity | None = None
    settling: measures.Settling | None = None
    link: measures.LinkBudget | None = None
    rates: measures.Rates | None = None

    @property
    def findings(self) -> tuple[WiringFinding, ...]:
        """The faults of the wiring, in words; empty if there are none."""
        return self.diagnosis.findings

    @property
    def remarks(self) -> tuple[str, ...]:
        """The faults of the instrument, in words."""
        found = []
        if (n := self.noise) and n.described > 0 and n.typical > _LOUD * n.described:
            times = f"{n.typical / n.described:.0f} times that of the skin's description"
            found.append(f"noise is {in_words(n.typical)}, {times}; check shields, supply and ground")
        if (n := self.noise) and n.worst > _LOUD * 2 * n.typical:
            noisiest = f"electrode {n.worst_electrode} is noisier than the others"
            found.append(f"{noisiest}: {in_words(n.worst)}; check its contact")
        if (o := self.offset) and o.rms > 5 * o.noise:
            most = f"{in_words(o.rms)} rms, most at electrode {o.worst_electrode}"
            cancelled = "differences cancel it, but not where a touch changes the current, as of a voltage source"
            found.append(f"voltages have an offset of {most}; {cancelled}")
        if (lin := self.linearity) and lin.error > max(_BENT, 5 * lin.noise):
            found.append(f"currents do not add up by {100 * lin.error:.2g} %: out of range, or a touched skin?")
        if (s := self.settling) and not s.settled:
            instead = f"{in_words(s.needed, 's')} instead of {in_words(s.settle_time, 's')}"
            more = f"wait {instead if s.needed > s.settle_time else 'longer'}"
            found.append(f"{100 * s.left:.2g} % of a step is left when voltages are sampled; {more}")
        return tuple(found)

    def table(self) -> list[tuple[str, str]]:
        """The measurements, as rows of a name and a value as text."""
        rows, d = [], self.diagnosis
        if math.isfinite(d.conductivity):
            rows.append(("sheet conductivity that fits", f"{1e3 * d.conductivity:.4g} mS per square"))
            rows.append(("measured against the model", f"{100 * d.misfit:.2g} % rms"))
        n, o, lin, s, k, r = self.noise, self.offset, self.linearity, self.settling, self.link, self.rates
        if not (n and o and lin and s and k and r):
            return rows
        seconds = partial(in_words, unit="s")
        network = f"{100 * lin.error:.2g} % of the signal (noise alone {100 * lin.noise:.2g} %)"
        left = f"{100 * s.left:.2g} +- {100 * s.noise:.1g} % of a step left after {seconds(s.settle_time)}"
        moved = f", {k.bytes_per_scan:.0f} bytes" if k.bytes_per_scan else ""
        name, best = max(r.proposed.items(), key=lambda item: item[1])
        return [
            *rows,
            ("noise of a voltage", f"{in_words(n.typical)} (described {in_words(n.described)})"),
            ("offset", f"{in_words(o.rms)} rms (noise alone {in_words(o.noise)})"),
            ("R(ab) + R(bc) - R(ac)", network),
            ("misfit of any network", f"{100 * lin.reciprocity:.2g} % of the signal"),
            ("settling", left),
            ("round trip", f"{seconds(k.round_trip)} median, {seconds(k.worst_round_trip)} longest"),
            ("base scan", f"{seconds(k.scan_time)}{moved} (the device states {seconds(k.own_time)})"),
            ("requests sent again", str(k.retries)),
            *((f"{mode} cycles", f"{rate:.4g} per second") for mode, rate in r.cycles.items()),
            ("fastest mode", f"{name} at {best:.4g} a second, waiting {seconds(r.settle_time)}"),
        ]

    def to_json(self) -> str:
        """The result as JSON text; unknown values are null."""
        return json.dumps(as_plain({**asdict(self), "remarks": self.remarks}), indent=1)


def self_test(device: Device, skin: Skin, progress: Callable[[str], None] = lambda _: None) -> SelfTest:
    """Test wiring and instrument. Keep the skin untouched meanwhile.

    Args:
        device: A device that can drive any pattern; a recording cannot.
        skin: Its description.
        progress: Called with the name of the next part.

    Raises:
        DeviceError: If the device is a recording, has another number of electrodes, or is lost.
    """
    n_elec = len(skin.electrodes)
    if device.reference:
        raise DeviceError("a recording cannot be tested: it has one pattern only; `ohmskin image` judges its data")
    measures.check_fit(device, skin)
    progress("driving every pair of electrodes")
    frames = [measures.scan_whole(device, terminal_pattern(n_elec)) for _ in range(_REPEATS)]
    mean = measures.mean_frame(frames)
    progress("comparing with the model")
    diagnosis = diagnose(skin, mean)
    date = datetime.now(UTC).isoformat(timespec="seconds")
    untested = SelfTest(skin.name, device.capabilities.name, date, diagnosis)
    alive = np.flatnonzero(~np.isnan(diagnosis.series)).tolist()
    if len(alive) < 6:
        return untested
    noise = measures.measure_noise(frames, alive, skin)
    progress("reversing currents")
    offset = measures.measure_offset(device, noise, alive)
    linearity = measures.measure_linearity(mean, len(frames), noise, alive, diagnosis.contradiction)
    progress("measuring the settling time")
    settling = measures.measure_settling(device, noise, alive)
    progress("measuring the speed of the link")
    link = measures.measure_link(device, drive_of(mode_named(skin, ""), skin).next((), 0), alive)
    rates = measures.propose_rates(device, skin, link, settling)
    return replace(untested, noise=noise, offset=offset, linearity=linearity, settling=settling, link=link, rates=rates)
