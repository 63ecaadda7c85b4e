"""The instrument of a skin: the source of its injections and the converter of its voltages."""

from dataclasses import dataclass

from ohmskin.skin.checks import choice, number


@dataclass(frozen=True)
class Excitation:
    """The source that drives a pair of electrodes, and the multiplexers in its path."""

    source: str = choice("voltage", "voltage", "current")
    amplitude: float = number(5.0, 1e-9, 1e3, "V or A")
    resistance: float = number(50.0, 0, 1e9, "ohm")
    multiplexer_resistance: float = number(100.0, 0, 1e6, "ohm")
    current_limit: float = number(20e-3, 1e-9, 1e3, "A")


@dataclass(frozen=True)
class Converter:
    """What digitises the voltages, all channels of an injection at once."""

    noise: float = number(0.2e-3, 0, 1e3, "V")
    bits: int = number(16, 4, 32)
    full_scale: float = number(5.0, 1e-9, 1e4, "V")
    shunt: float = number(100.0, 1e-6, 1e9, "ohm")
    settle: float = number(100e-6, 0, 10, "s")
    conversion: float = number(20e-6, 0, 10, "s")
    time_constant: float = number(8e-6, 0, 10, "s")
