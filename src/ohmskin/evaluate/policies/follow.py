"""A tracker at work: a policy asks, a filter believes, a few injections per frame."""

from ohmskin.evaluate.policies.lab import Lab, Scan
from ohmskin.touch import Contact
from ohmskin.touch.filter import ContactFilter

PERIOD = 10e-3  # seconds between frames


class Follower:
    """Follows contacts with a few injections per frame, as mode ``16T`` of the loop does.

    Args:
        lab: The skin, and what is believed of it.
        injections: Per frame; up to two of them explore.

    Attributes:
        scene: What is believed to touch the skin.
        turn: Frames so far; says where the round of exploring injections is.
    """

    def __init__(self, lab: Lab, injections: int) -> None:
        self._lab, self.turn = lab, 0
        self._policy = lab.policy(injections)
        self._filter = ContactFilter(lab.explainer)
        self.scene = self._filter.start()

    def step(self, scan: Scan) -> tuple[Contact, ...]:
        """One frame more; the contacts reported after it."""
        pattern = self._policy.next(self.scene.targets, self.turn)
        self.turn += 1
        self.scene = self._filter.update(self.scene, scan(pattern), PERIOD, self._lab.reference(pattern))
        return self.scene.contacts
