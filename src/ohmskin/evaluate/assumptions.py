"""What the paper leaves open, each taken once otherwise than in the figures, all else as there."""

from dataclasses import dataclass

from ohmskin.errors import OhmskinError
from ohmskin.evaluate.worlds import WORLDS


@dataclass(frozen=True)
class Assumption:
    """One departure from how the figures are made; the defaults are theirs.

    Args:
        title: What is otherwise, in a few words.
        driven: Whether images use the voltages of the electrodes that carry the current, too. The choice of pairs and
            gamma_0 stay those of the other voltages.
        source: What is known of a voltage source's currents: ``""``: a current source; ``measured``; ``unmeasured``,
            taken to be those of the untouched sheet.
        noise: What the noise is in proportion to: ``""``: the same for all voltages of all methods; ``scan``: the
            largest voltage of each scan; ``voltage``: each voltage.
        decibels: Noise level of all experiments (dB); 0: that of the figures.
        radius, strength: Of contacts, over those of the figures.
        amplitude: Prior amplitude s, over that of the figures.
        prior: Of images, by name.
        pairs: Injections of the adaptive scan.
        same_mesh: Whether data are made on the estimator's mesh (discs only).
        worlds: Where it can be put to the test.
    """

    title: str
    driven: bool = False
    source: str = ""
    noise: str = ""
    decibels: float = 0.0
    radius: float = 1.0
    strength: float = 1.0
    amplitude: float = 1.0
    prior: str = "paper"
    pairs: int = 16
    same_mesh: bool = False
    worlds: tuple[str, ...] = WORLDS


STATED = Assumption("as in the figures")
ASSUMPTIONS = {
    "stated": STATED,
    "driven": Assumption("driven electrodes are in the images, too", driven=True),
    "source": Assumption("voltage source, currents not measured", source="unmeasured"),
    "measured": Assumption("voltage source, currents measured", source="measured"),
    "scan": Assumption("noise in proportion to each scan's largest voltage", noise="scan"),
    "voltage": Assumption("noise in proportion to each voltage", noise="voltage"),
    "quiet": Assumption("noise 80 dB below the largest voltage", decibels=80.0),
    "small": Assumption("contacts of half the radius", radius=0.5),
    "large": Assumption("contacts of 1.5 times the radius", radius=1.5),
    "strong": Assumption("contacts ten times as strong", strength=10.0),
    "smooth": Assumption("a tenth of the prior amplitude: strong regularisation", amplitude=0.1),
    "sharp": Assumption("ten times the prior amplitude: weak regularisation", amplitude=10.0),
    "laplacian": Assumption("EIDORS' Laplace prior", prior="laplacian"),
    "tikhonov": Assumption("zeroth-order Tikhonov prior", prior="tikhonov"),
    "noser": Assumption("NOSER prior", prior="noser"),
    "pairs": Assumption("32 pairs in the adaptive scan", pairs=32),
    "same mesh": Assumption("data made on the estimator's mesh", same_mesh=True, worlds=WORLDS[:1]),
}
"""By name; the first one changes nothing."""


def assumption(name: str) -> Assumption:
    """The assumption of that name.

    Raises:
        OhmskinError: If there is none.
    """
    if name not in ASSUMPTIONS:
        raise OhmskinError(f"no assumption {name!r}; choose from {', '.join(ASSUMPTIONS)}")
    return ASSUMPTIONS[name]
