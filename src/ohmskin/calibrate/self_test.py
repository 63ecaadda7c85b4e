"""The self-test of a skin: is every electrode connected as it should be, and what is the instrument worth?"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime

import numpy as np

from ohmskin.arrays import as_plain
from ohmskin.calibrate import measures
from ohmskin.calibrate.findings import Diagnosis, Finding
from ohmskin.calibrate.wiring import diagnose, terminal_pattern
from ohmskin.device import Device
from ohmskin.errors import DeviceError
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin

_REPEATS = 12
_LOUD = 3.0  # times the described noise above which the measured one is a finding
_BENT = 0.02  # share of the signal that linearity may miss


@dataclass(frozen=True, eq=False)
class SelfTest:
    """What the self-test found. All but the diagnosis are None where too few electrodes are connected to measure them.

    Args:
        skin: Name of the skin's description.
        device: Name of the device.
        date: When, UTC, in ISO form.
        diagnosis: Wiring and sheet.
        noise, offset, linearity, settling, link, rates: What the instrument is worth.
    """

    skin: str
    device: str
    date: str
    diagnosis: Diagnosis
    noise: measures.Noise | None = None
    offset: measures.Offset | None = None
    linearity: measures.Linearity | None = None
    settling: measures.Settling | None = None
    link: measures.LinkBudget | None = None
    rates: measures.Rates | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the wiring, in plain words; empty if nothing is."""
        return self.diagnosis.findings

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is not as it should be with the instrument."""
        found = []
        if (n := self.noise) and n.described > 0 and n.typical > _LOUD * n.described:
            times = f"{n.typical / n.described:.0f} times what the skin's description says"
            found.append(f"noise is {_si(n.typical, 'V')}, {times}; check shields, supply and ground")
        if (n := self.noise) and n.worst > _LOUD * 2 * n.typical:
            noisiest = f"electrode {n.worst_electrode} is noisier than the others"
            found.append(f"{noisiest}: {_si(n.worst, 'V')}; check its contact")
        if (o := self.offset) and o.rms > 5 * o.noise:
            most = f"{_si(o.rms, 'V')} rms, most at electrode {o.worst_electrode}"
            found.append(f"voltages have an offset of {most}; differences cancel it")
        if (lin := self.linearity) and lin.error > max(_BENT, 5 * lin.noise):
            found.append(f"currents do not add up by {100 * lin.error:.2g} %: out of range, or a touched skin?")
        if (s := self.settling) and not s.settled:
            instead = f"{_si(s.needed, 's')} instead of {_si(s.settle_time, 's')}"
            more = f"wait {instead if s.needed > s.settle_time else 'longer'}"
            found.append(f"{100 * s.left:.2g} % of a step is left when voltages are sampled; {more}")
        return tuple(found)

    def table(self) -> list[tuple[str, str]]:
        """What was measured, as rows of name and value in words."""
        d = self.diagnosis
        rows = []
        if math.isfinite(d.conductivity):
            rows.append(("sheet conductivity that fits", f"{1e3 * d.conductivity:.4g} mS per square"))
            rows.append(("measured against the model", f"{100 * d.misfit:.2g} % rms"))
        if (n := self.noise) is not None:
            rows.append(("noise of a voltage", f"{_si(n.typical, 'V')} (described {_si(n.described, 'V')})"))
        if (o := self.offset) is not None:
            rows.append(("offset", f"{_si(o.rms, 'V')} rms (noise alone {_si(o.noise, 'V')})"))
        if (lin := self.linearity) is not None:
            left = f"{100 * lin.error:.2g} % of the signal (noise alone {100 * lin.noise:.2g} %)"
            rows.append(("R(ab) + R(bc) - R(ac)", left))
            rows.append(("against any network", f"{100 * lin.reciprocity:.2g} % of the signal"))
        if (s := self.settling) is not None:
            left = f"{100 * s.left:.2g} +- {100 * s.noise:.1g} % of a step left after {_si(s.settle_time, 's')}"
            rows.append(("settling", left))
        if (k := self.link) is not None:
            rows.append(("round trip", f"{_si(k.round_trip, 's')} median, {_si(k.worst_round_trip, 's')} longest"))
            moved = f", {k.bytes_per_scan:.0f} bytes" if k.bytes_per_scan else ""
            rows.append(("base scan", f"{_si(k.scan_time, 's')}{moved} (the device says {_si(k.own_time, 's')})"))
            rows.append(("requests sent again", str(k.retries)))
        if (r := self.rates) is not None:
            rows += [(f"{name} cycles", f"{rate:.4g} per second") for name, rate in r.cycles.items()]
            name, best = list(r.proposed.items())[-1]
            rows.append(("best with this wiring", f"{name} at {best:.4g} a second, waiting {_si(r.settle_time, 's')}"))
        return rows

    def to_json(self) -> str:
        """All of it as JSON text; what is not known is null."""
        return json.dumps(as_plain({**asdict(self), "remarks": self.remarks}), indent=1)


def self_test(device: Device, skin: Skin, progress: Callable[[str], None] = lambda _: None) -> SelfTest:
    """Test wiring and instrument. Nothing may touch the skin meanwhile.

    Args:
        device: A device that can drive any pattern; a recording cannot.
        skin: What it should be.
        progress: Called with what comes next, in words.

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
    useless = [e for e in range(n_elec) if np.isnan(diagnosis.series[e])]
    if n_elec - len(useless) < 6:
        return untested
    noise = measures.measure_noise(frames, useless, skin)
    progress("reversing currents")
    offset = measures.measure_offset(device, noise, useless)
    linearity = measures.measure_linearity(mean, len(frames), noise, useless, diagnosis.contradiction)
    progress("switching and waiting")
    settling = measures.measure_settling(device, noise, useless)
    progress("timing the link")
    link = measures.measure_link(device, drive_of(mode_named(skin, ""), skin).next((), 0), useless)
    rates = measures.propose_rates(device, skin, link, settling)
    return replace(untested, noise=noise, offset=offset, linearity=linearity, settling=settling, link=link, rates=rates)


def _si(value: float, unit: str) -> str:
    """A value in words, such as "205 uV"."""
    if not math.isfinite(value) or value == 0:
        return f"{value:g} {unit}"
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "u")):
        if abs(value) >= 0.9995 * factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value / 1e-9:.3g} n{unit}"
