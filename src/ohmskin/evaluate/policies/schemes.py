"""What is compared: drives and readers of the product, by the short names of the tables."""

from dataclasses import replace

from ohmskin.drive import complete_pattern
from ohmskin.errors import OhmskinError
from ohmskin.evaluate.setup import Setup
from ohmskin.scan import Cost
from ohmskin.skin import Mode, Skin

SCHEMES = {  # what it does, the product's name, and the usual number of injections
    "12B": ("adjacent drive, 12 electrodes on the rim", "rim", 12),
    "16I": ("adjacent drive, 12 electrodes on the rim and 4 inside", "rings", 16),
    "best": ("the fixed set of injections that is best for positions, over the whole sheet", "best", 28),
    "16O fused": ("the paper's: 12B, then pairs by eq. (7); both scans used", "eq7", 28),
    "16P": ("6 opposite drives on all electrodes, then pairs by position information", "position", 28),
    "16T": ("a few injections per frame, up to two exploring, the others by position information", "tracking", 4),
    "rotating": ("a few injections per frame in a fixed round of opposite electrodes", "rotating", 4),
    "rotating best": ("a few injections per frame in a fixed round of the best set of 16", "rotating_best", 4),
}
NAMES = {"discs": "discs", "pressed": "contact-layer twin"}  # of worlds
INSTRUMENTS = ("parallel", "multiplexed")
YARDSTICK = "16O fused"  # whose time on an instrument all schemes get


def scheme(key: str, reading: str = "centroid") -> Mode:
    """The mode of a key, a drive or a drive and its injections, such as ``16P/16``, with a reader of `READERS`.

    ``fit, driven``: the reader ``fit``, electrodes that carry the current measured, too.

    Raises:
        OhmskinError: If there is none.
    """
    drive, _, count = key.partition("/")
    if drive not in SCHEMES or not (count.isdigit() or not count):
        choices = ", ".join(SCHEMES)
        raise OhmskinError(f"no scheme {key!r}; choose from {choices}, with /INJECTIONS if not the usual number")
    _, name, usual = SCHEMES[drive]
    reader, _, driven = reading.partition(", ")
    return Mode(key, name, reader, injections=int(count) if count else usual, driven=bool(driven))


def within(key: str, instrument: str, setup: Setup) -> Mode:
    """A scheme with as many injections as it has time for while the paper's does its own, on an instrument with the
    skin's times.

    ``parallel`` instruments convert all voltages of an injection at once, as the paper's does; ``multiplexed`` ones one
    by one.

    Raises:
        OhmskinError: If there is no such instrument or scheme.
    """
    cost, usual, yardstick = instrument_cost(instrument, setup.skin), scheme(key), scheme(YARDSTICK)
    if key == YARDSTICK:
        return usual
    one = cost.time(next(complete_pattern(setup.electrodes).split(1)))
    base = setup.drive(yardstick).patterns[0]
    seconds = cost.time(base) + (yardstick.injections - base.n_inj) * one
    own = cost.time(next(setup.drive(usual).patterns[0].split(1)))
    return replace(usual, injections=int(seconds / own * (1 + 1e-9)))


def instrument_cost(instrument: str, skin: Skin) -> Cost:
    """What scans cost on an instrument with the times of a skin's.

    Raises:
        OhmskinError: If there is no such instrument.
    """
    if instrument not in INSTRUMENTS:
        raise OhmskinError(f"no instrument {instrument!r}; choose from {', '.join(INSTRUMENTS)}")
    return replace(skin.cost, channels=0 if instrument == "parallel" else 1)
