"""What choosing costs: its share of a frame's computing."""

import time
from dataclasses import dataclass

import numpy as np

from ohmskin.evaluate.policies.schemes import scheme
from ohmskin.evaluate.result import Result
from ohmskin.evaluate.setup import PERIOD, setup
from ohmskin.evaluate.worlds import contact
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import Scan


@dataclass(frozen=True)
class Cost:
    """Processor time of the tracker's frame, with several contacts that rest. Another run, or machine, has other
    figures.

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
        where = setup("discs", self.decibels)
        sensor = where.sensor(scheme(f"16T/{self.injections}", "tracked"))
        places = ((0.06, 0.07), (0.14, 0.13), (0.06, 0.15), (0.15, 0.05))
        choose, update = np.empty((2, self.contacts + 1, self.frames))
        for n in range(self.contacts + 1):
            contacts = tuple(contact("discs", *place) for place in places[:n])
            state = sensor.start()
            for k in range(-30, self.frames):  # the first ones find the contacts, and compile
                asked: list[int] = []
                scan = _noting(where.scan(contacts, 4, k + 30, time=PERIOD * (k + 30)), asked)
                started = time.process_time_ns()
                state, _ = sensor.step(state, scan)
                if k >= 0:
                    choose[n, k] = 1e-9 * (asked[0] - started)
                    update[n, k] = 1e-9 * (time.process_time_ns() - asked[1])
        return {"choose": choose, "update": update}


def _noting(scan: Scan, times: list[int]) -> Scan:
    """A scan that notes the processor time (ns) before and after it."""

    def measure(pattern: DrivePattern) -> Frame:
        times.append(time.process_time_ns())
        frame = scan(pattern)
        times.append(time.process_time_ns())
        return frame

    return measure
