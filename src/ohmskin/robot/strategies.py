"""How a robot answers a touch: how quickly the touched place gives way, what stands still, what stays."""

from collections.abc import Callable
from dataclasses import dataclass

from ohmskin.body import Body
from ohmskin.errors import ModelError

_USUAL = 5.0  # N, taken for the force where none is estimated, as in the first frames of a contact
_FASTEST = 0.25  # m/s, of a place that is touched
_SOFT = 0.02  # m/s for each newton that is felt: the admittance
_WANTED = 2.0  # N, kept by a robot that follows
_STILL = 0.75  # s in which a robot comes back


@dataclass(frozen=True)
class ReactionStrategy:
    """How a robot answers.

    Args:
        title: In words.
        speed: Speed (m/s) inwards along the skin's normal, of the force on it (N); None: it is not known.
        halts: Whether its own movement stands still while it is touched.
        returns: Time (s) within which it comes back to where it was; None: it stays.
        needs_force: Whether the skin must be calibrated to newtons.
    """

    title: str
    speed: Callable[[float | None], float]
    halts: bool = True
    returns: float | None = None
    needs_force: bool = False


def _admitted(force: float | None) -> float:
    return min(_FASTEST, _SOFT * (_USUAL if force is None else force))


def _following(force: float | None) -> float:
    return 0.0 if force is None else min(_FASTEST, max(-_FASTEST / 5, _SOFT * (force - _WANTED)))


STRATEGIES = {
    "yield": ReactionStrategy(
        "moves on, and yields the faster the larger the force", _admitted, halts=False, returns=_STILL
    ),
    "stiff": ReactionStrategy("does not react", lambda _: 0.0, halts=False),
    "stop": ReactionStrategy("stands still while it is touched", lambda _: 0.0),
    "retract": ReactionStrategy("withdraws at once, then returns", lambda _: _FASTEST, returns=_STILL),
    "follow": ReactionStrategy("keeps a contact at 2 N, moving both ways", _following, needs_force=True),
    "guide": ReactionStrategy("goes where it is pushed, and stays there", _admitted),
}
"""By name, for `ohmskin robot --strategy`."""


def strategy_named(name: str, body: Body) -> ReactionStrategy:
    """The strategy of that name, for a robot in skins.

    Raises:
        ModelError: If there is none, or it needs newtons and a skin is not calibrated to them.
    """
    if name not in STRATEGIES:
        raise ModelError(f"no reaction strategy {name!r}; choose from {', '.join(STRATEGIES)}")
    uncalibrated = [placed.patch.name for placed in body.patches if not placed.patch.newtons]
    if STRATEGIES[name].needs_force and uncalibrated:
        told = f"strategy {name!r} needs newtons, which skin {uncalibrated[0]!r} does not have"
        raise ModelError(f"{told}; calibrate it with `ohmskin calibrate`, or choose another strategy")
    return STRATEGIES[name]
