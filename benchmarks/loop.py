"""The live loop against the virtual skin over TCP: rate, latency, memory. Run with ``make bench`` (ARGS="--frames
2000").

One press wanders, so that the twin works too. Memory is told after a tenth of the frames and at the end, for this
process and its children, because the claim is that nothing grows.
"""

import argparse
import gc
import json
import os
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import psutil

from ohmskin import Engine, Skin, connect
from ohmskin.device.demo import demo_finger


def measure(frames: int, realtime: bool) -> dict[str, float | str]:
    """Figures of a run of so many adaptive frames; `realtime`: the device takes the time that an instrument would."""
    skin = Skin.load("paper")
    process = psutil.Process()
    with Engine(lambda: connect("virtual:", skin=skin, seed=1, realtime=realtime), skin, "16O") as engine:
        engine.calibrate()
        gc.collect()
        gc.freeze()
        memory = []
        felt, health, start = 0, None, time.monotonic()
        for k in range(frames):
            engine.press(0, *demo_finger(skin.domain, k * 0.008))
            touch = engine.step()
            assert touch is not None, engine.message
            felt, health = felt + bool(touch.contacts), touch.health
            if k in (frames // 10, frames - 1):
                memory.append(sum(p.memory_info().rss for p in [process, *process.children(recursive=True)]) / 2**20)
        seconds = time.monotonic() - start
    assert health is not None
    return {
        "device": "as fast as the instrument" if realtime else "as fast as it can",
        "adaptive frames": frames,
        "frames per second": frames / seconds,
        "latency p50 / ms": 1e3 * health.latency_p50,
        "latency p99 / ms": 1e3 * health.latency_p99,
        "share waiting for device": health.waiting,
        "frames with a contact": felt / frames,
        "dropped": health.dropped,
        "memory after a tenth / MiB": memory[0],
        "memory at the end / MiB": memory[-1],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    results = [measure(arguments.frames, realtime) for realtime in (True, False)]
    for result in results:
        for name, value in result.items():
            print(f"{name:<28}{value if isinstance(value, str) else f'{value:.5g}'}")
        print()
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
