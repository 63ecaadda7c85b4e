"""The live loop for a long time: memory and latency as they go. Run with ``python -m benchmarks.soak --seconds 600``.

Prints a line now and then, and at the end whether anything grew; the exit status is 1 if it did. Memory is that of
this process and its children; the first fifth warms up.
"""

import argparse
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import psutil

from ohmskin import Engine, Skin, connect
from ohmskin.device.demo import demo_finger

_GROWTH = 0.05  # of the memory, from after the first fifth to the end
_SLOWER = 2.0  # times the median latency


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--device", default="virtual:")
    parser.add_argument("--mode", default="")
    arguments = parser.parse_args()
    skin, process = Skin.load("paper"), psutil.Process()

    def memory() -> float:
        return float(sum(p.memory_info().rss for p in [process, *process.children(recursive=True)]) / 2**20)

    rows = []
    with Engine(lambda: connect(arguments.device), skin, arguments.mode) as engine:
        engine.calibrate()
        virtual = engine.device.capabilities.virtual
        start = time.monotonic()
        step = arguments.seconds / 20
        print("seconds   cycles  per second  latency p50/ms  p99/ms  dropped  memory/MiB")
        while len(rows) < 20:
            touch = None
            while time.monotonic() < start + step * (len(rows) + 1):
                if virtual:
                    engine.press(0, *demo_finger(skin.domain, time.monotonic() - start))
                touch = engine.step() or touch
            if touch is None:
                sys.exit(f"no cycle in {step:.0f} s: {engine.message}")
            h = touch.health
            rows.append(
                (
                    time.monotonic() - start,
                    h.cycles,
                    h.rate,
                    1e3 * h.latency_p50,
                    1e3 * h.latency_p99,
                    h.dropped,
                    memory(),
                )
            )
            print("{:7.0f}{:9d}{:12.1f}{:16.3f}{:8.3f}{:9d}{:12.1f}".format(*rows[-1]), flush=True)
    settled, last = rows[3], rows[-1]
    grown, slower = last[6] / settled[6] - 1, last[3] / settled[3]
    good = grown < _GROWTH and slower < _SLOWER
    told = f"memory {100 * grown:+.1f} % (at most {100 * _GROWTH:g}), latency x {slower:.2f} (at most {_SLOWER:g})"
    print(f"{told}: {'pass' if good else 'short'}")
    sys.exit(not good)


if __name__ == "__main__":
    main()
