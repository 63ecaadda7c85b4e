"""What choosing costs: its share of a frame's computing."""

import time
from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.policies.follow import PERIOD
from ohmskin.evaluate.policies.lab import lab
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.worlds import contact
from ohmskin.touch.filter import ContactFilter


@dataclass(frozen=True)
class Cost:
    """Processor time of the tracker's frame, with several contacts that rest. Another run, or machine, has other figures.

    Args:
        decibels: Noise level (dB).
        injections: Per frame.
        contacts: Most contacts.
        frames: Timed frames of each number of contacts.
    """

    decibels: float
    injections: int = 4
    contacts: int = 2
    frames: int = 300

    def run(self) -> Result:
        """Results: ``choose`` and ``update`` (n_contacts + 1, n_frames) in seconds, with 0, 1, ... contacts."""
        room = lab("discs", self.decibels)
        policy, keeper = room.policy(self.injections), ContactFilter(room.explainer)
        places = ((0.06, 0.07), (0.14, 0.13), (0.06, 0.15), (0.15, 0.05))
        choose, update = np.empty((2, self.contacts + 1, self.frames))
        for n in range(self.contacts + 1):
            contacts = tuple(contact("discs", *place) for place in places[:n])
            scene = keeper.start()
            for k in range(-30, self.frames):  # the first ones find the contacts, and compile
                scan = room.scan(contacts, 4, k + 30)
                started = time.process_time_ns()
                pattern = policy.next(scene.targets, k + 30)
                chosen = time.process_time_ns()
                difference, reference = scan(pattern), room.reference(pattern)
                measured = time.process_time_ns()
                scene = keeper.update(scene, difference, PERIOD, reference)
                if k >= 0:
                    choose[n, k], update[n, k] = 1e-9 * (chosen - started), 1e-9 * (time.process_time_ns() - measured)
        return {"choose": choose, "update": update}
