"""Capabilities: what a device reports about itself."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import cached_property
from typing import Any, Self

import numpy as np

from ohmskin.device.layout import MAX_PACKET
from ohmskin.errors import PatternError, ProtocolError
from ohmskin.scan import Cost, DrivePattern, Frame

_ROUNDING = 1e-6  # share of the full scale
_LONGEST = 1e6  # s; what is larger is not in seconds


class Feature(IntFlag):
    """Features of a device in addition to scanning."""

    VIRTUAL = 1  #: simulated: touches can be put on it with `press`
    CURRENT_MEASURED = 2  #: the currents of a frame are measured, not nominal
    VOLTAGE_SOURCE = 4  #: it drives volts; otherwise amperes
    DRIVEN_MEASURED = 8  #: voltages of the electrodes that carry the current can be measured, too
    AUXILIARY = 16  #: each frame has one value more, of a sensor beside the electrodes


_RECORDED: dict[str, Any] = {
    "name": str,
    **dict.fromkeys(("n_electrodes", "max_injections", "max_measurements", "features", "serial"), int),
    **dict.fromkeys(("excitation", "full_scale", "settle_time", "conversion_time"), float),
}


@dataclass(frozen=True)
class Capabilities:
    """What a device is and its limits per scan.

    Args:
        name: Name of the device, at most 32 bytes of UTF-8.
        n_electrodes: Number of electrodes.
        max_injections: Most injections in one pattern.
        max_measurements: Most measurements in one pattern.
        pattern_slots: Patterns that it stores at once.
        features: What it can do in addition to scanning.
        excitation: Driving amplitude (V with Feature.VOLTAGE_SOURCE, otherwise A).
        full_scale: Largest voltage it can measure (V).
        settle_time: Waiting time after each change of injection (s).
        conversion_time: Time of one voltage measurement (s).
        serial: Unique number of this device.
        firmware: Version of its software.
        boot: A number that changes whenever it starts.

    Raises:
        ProtocolError: If a number is out of range.
    """

    name: str
    n_electrodes: int
    max_injections: int
    max_measurements: int
    pattern_slots: int = 4
    features: Feature = Feature(0)
    excitation: float = 0.0
    full_scale: float = 0.0
    settle_time: float = 0.0
    conversion_time: float = 0.0
    serial: int = 0
    firmware: tuple[int, int, int] = (0, 0, 0)
    boot: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "name", re.sub(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", "?", self.name)
        )  # it goes to terminals
        if len(self.name.encode()) > 32:
            raise ProtocolError(f"device name {self.name!r} has {len(self.name.encode())} bytes; at most 32")
        most = {"n_electrodes": 65535, "max_injections": 65535, "max_measurements": 65535, "pattern_slots": 255}
        for name, high in most.items():
            low = 2 if name == "n_electrodes" else 1
            if not low <= (count := getattr(self, name)) <= high:
                raise ProtocolError(f"{name} is {count}; it must be {low}..{high}")
        for name in ("excitation", "full_scale", "settle_time", "conversion_time"):
            if not (math.isfinite(value := getattr(self, name)) and value >= 0):
                raise ProtocolError(f"{name} is {value}; it must be finite and not negative")
        for name in ("settle_time", "conversion_time"):
            if (value := getattr(self, name)) > _LONGEST:
                raise ProtocolError(f"{name} is {value:g} s; it must be at most {_LONGEST:g} s")
        largest = 4 * self.max_injections + 6 * self.max_measurements
        if largest > MAX_PACKET - 512:  # leaves room for header, checksum and byte stuffing
            size = f"max_injections and max_measurements make {largest} bytes"
            raise ProtocolError(f"{size}; one packet holds {MAX_PACKET - 512}")

    def as_texts(self) -> dict[str, str]:
        """What a recording keeps of them, by name."""
        return {name: str(kind(getattr(self, name))) for name, kind in _RECORDED.items()}

    @classmethod
    def from_texts(cls, texts: Mapping[str, str]) -> Self:
        """Capabilities from their texts, `texts` as `as_texts` gives them; those of a replay, which cannot be pressed.

        Raises:
            KeyError, ValueError, OverflowError, ProtocolError: If an entry is missing or invalid.
        """
        values = {name: kind(texts[name]) for name, kind in _RECORDED.items()}
        return cls(**values | {"features": Feature(values["features"] & 31) & ~Feature.VIRTUAL})

    @property
    def virtual(self) -> bool:
        """Whether it can be pressed with `press`."""
        return Feature.VIRTUAL in self.features

    @property
    def driven(self) -> bool:
        """Whether electrodes that carry the current can be measured."""
        return Feature.DRIVEN_MEASURED in self.features

    @cached_property
    def cost(self) -> Cost:
        """Upper bound of the time of a scan: the number of voltages converted at once is not known, so one by one."""
        return Cost(self.settle_time, self.conversion_time, channels=1)

    def scan_time(self, pattern: DrivePattern) -> float:
        """How long a scan of `pattern` takes the device (s)."""
        return self.cost.time(pattern)

    def limited(self, frame: Frame) -> Frame:
        """A frame in which voltages beyond the device's range are infinite, as clipped ones are."""
        beyond = np.abs(frame.voltages) > (self.full_scale or math.inf) * (1 + _ROUNDING)
        if not np.count_nonzero(beyond):
            return frame
        return replace(frame, voltages=np.where(beyond, np.copysign(np.inf, frame.voltages), frame.voltages))

    def check(self, pattern: DrivePattern) -> None:
        """Raise PatternError unless the device can drive `pattern` in one scan."""
        try:
            pattern.check(self.n_electrodes)
        except PatternError as error:
            raise PatternError(f"{error} on device {self.name!r}; was the pattern made for this skin?") from error
        if pattern.n_inj <= self.max_injections and pattern.n_meas <= self.max_measurements:
            return
        per_injection = int(pattern.measured.max())
        fits = min(self.max_injections, self.max_measurements // per_injection)
        advice = f"scan the pieces of pattern.split({fits})" if fits else "measure fewer voltages of each injection"
        raise PatternError(
            f"the pattern has {pattern.n_inj} injections and {pattern.n_meas} measurements; device {self.name!r} takes "
            f"{self.max_injections} and {self.max_measurements} at a time; {advice}"
        )
