"""From the last sample of a cycle to a subscriber in another process: shared memory (Python, C++) and zenoh, with page
and recorder on.

    python -m benchmarks.latency --seconds 20 --picture docs/images/guide/latency.png

The skin is the virtual one, its scans paced to about 200 frames a second (two scans per frame); a browser-like reader
keeps the page busy, a recorder writes everything. The time of a sample is the device's, put on this machine's clock as
the loop does it: the fastest transit ever seen is not in it (see `Health`). Clients run one after the other, each in a
process of its own.
"""

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import psutil

from ohmskin import Engine, Skin, connect
from ohmskin.client import board
from ohmskin.device.demo import demo_finger
from ohmskin.outlets.publisher import Publisher
from ohmskin.recording import Recorder
from ohmskin.view import LiveView
from ohmskin.view.session import PageSession

_ZENOH = "tcp/127.0.0.1:17461"
_LISTEN = """
import json, sys, time
from ohmskin.client import Client
ages, numbers = [], []
with Client(sys.argv[1]) as client:
    while client.wait(1.0) is None:
        pass
    end = time.monotonic() + float(sys.argv[2])
    while time.monotonic() < end:
        newest = client.wait(0.5)
        if newest is not None:
            ages.append(newest.age)
            numbers.append(newest.sequence)
print(json.dumps([ages, numbers]))
"""

_LISTEN_CPP = """
#include <cstdio>
#include <ohmskin.hpp>
int main(int, char** arguments) {
    ohmskin::Client client(arguments[1]);
    while (!client.wait(1.0)) {}
    std::vector<std::pair<double, unsigned long long>> heard;
    for (const double end = ohmskin::now() + std::atof(arguments[2]); ohmskin::now() < end;)
        if (const ohmskin::Contacts* newest = client.wait(0.5)) heard.emplace_back(newest->age(), newest->sequence);
    std::printf("[[");
    for (std::size_t i = 0; i < heard.size(); ++i) std::printf("%s%.9g", i ? "," : "", heard[i].first);
    std::printf("],[");
    for (std::size_t i = 0; i < heard.size(); ++i) std::printf("%s%llu", i ? "," : "", heard[i].second);
    std::printf("]]");
}
"""
_PRESSES = 30  # a second: as often as the demonstration finger of a live page
_NAMES = ("shared memory", "shared memory, C++", "zenoh")

_BROWSE = """
import json, sys, time
from websockets.sync.client import connect
with connect(sys.argv[1].replace("http", "ws") + "socket") as page:
    while True:
        message = page.recv()
        if isinstance(message, bytes):
            time.sleep(1 / 30)
            length = int.from_bytes(message[:4], "little")
            page.send(json.dumps({"type": "ack", "sequence": json.loads(message[4 : 4 + length])["sequence"]}))
"""


def measure(seconds: float, rate: float) -> dict[str, Any]:
    """Ages (s) of what each client hears, and how the loop did meanwhile.

    Args:
        seconds: How long each client listens.
        rate: Frames per second that the loop is paced to; 0 for as many as the skin gives.
    """
    skin = Skin.load("paper")
    os.environ["OHMSKIN_BOARDS"] = tempfile.mkdtemp()
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        recorder = stack.enter_context(Recorder(Path(folder) / "latency.mcap", skin))
        engine = stack.enter_context(
            Engine(lambda: recorder.tee(connect("virtual:", skin=skin, seed=1, realtime=False)), skin, "16O")
        )
        recorder.watch(engine)
        session = stack.enter_context(PageSession(engine, "virtual:", LiveView(port=0), False))
        publisher = stack.enter_context(Publisher(skin, [f"zenoh:listen/{_ZENOH}"], "latency"))
        session.calibrate()
        browser = subprocess.Popen([sys.executable, "-c", _BROWSE, session.view.url], stderr=subprocess.DEVNULL)
        stack.callback(browser.kill)
        gc.collect()
        gc.freeze()
        results: dict[str, Any] = {}
        loads = []
        done = threading.Event()

        def listen() -> None:
            python = [sys.executable, "-c", _LISTEN]
            commands = [*python, "shm:latency"], [_compiled(folder), "latency"], [*python, f"zenoh:latency@{_ZENOH}"]
            for name, command in zip(_NAMES, commands, strict=True):
                said = subprocess.run([*command, str(seconds)], capture_output=True, check=True).stdout
                ages, numbers = json.loads(said)
                results[name] = {"ages": ages, "heard": len(numbers) / (numbers[-1] - numbers[0] + 1)}
            done.set()

        threading.Thread(target=listen, daemon=True).start()
        frames, presses, start = 0, 0, time.monotonic()
        while not done.is_set():
            if (passed := time.monotonic() - start) * _PRESSES >= presses:  # each takes the twin some milliseconds
                engine.press(0, *demo_finger(skin.domain, passed))
                presses += 1
            if (touch := session.step()) is not None:
                publisher.publish(touch)
                recorder.publish(touch)
                frames += 1
            if rate and (left := start + frames / rate - time.monotonic()) > 0:
                time.sleep(left)
            if frames % 500 == 0:
                loads.append(psutil.getloadavg()[0])
        results["loop"] = {
            "frames per second": frames / (time.monotonic() - start),
            "latency p50 / ms": 1e3 * touch.health.latency_p50 if touch else np.nan,
            "latency p99 / ms": 1e3 * touch.health.latency_p99 if touch else np.nan,
            "recorder dropped": sum(recorder.progress.dropped.values()),
            "cores": psutil.cpu_count(),
            "load average": float(np.mean(loads)),
        }
    return results


def _compiled(folder: str) -> str:
    """The listener in C++."""
    source, program = Path(folder) / "listen.cpp", str(Path(folder) / "listen")
    source.write_text(_LISTEN_CPP, encoding="utf-8")
    where = f"-I{Path(board.__file__).parent}"
    subprocess.run(["g++", "-std=c++17", "-O2", where, str(source), "-o", program], check=True)
    return program


def draw(results: dict[str, Any], path: Path) -> None:
    """Histograms of both ways, p50 and p99 marked."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(7, 3.4), layout="constrained")
    longest = max(1e3 * np.percentile(results[name]["ages"], 99.5) for name in ("shared memory", "zenoh"))
    for name, colour in (("shared memory", "#0057c2"), ("zenoh", "#c2410c")):
        ages = 1e3 * np.array(results[name]["ages"])
        p50, p99 = np.percentile(ages, [50, 99])
        label = f"{name}: p50 {p50:.1f} ms, p99 {p99:.1f} ms ({len(ages)} messages)"
        panel.hist(ages, np.linspace(0, longest, 80), histtype="stepfilled", alpha=0.35, color=colour, label=label)
        for value, style in ((p50, "-"), (p99, "--")):
            panel.axvline(value, color=colour, linestyle=style, linewidth=1.2)
    loop = results["loop"]
    panel.set_title(
        f"{loop['frames per second']:.0f} frames/s, page and recorder on, {loop['cores']} cores", fontsize=10
    )
    panel.set(xlabel="age of the last sample when a subscriber has it (ms)", ylabel="messages", xlim=(0, longest))
    panel.legend(framealpha=1, fontsize=9)
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--picture", type=Path, help="draw histograms to this file")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    results = measure(arguments.seconds, arguments.rate)
    figures: dict[str, Any] = {"loop": results["loop"]}
    for name in _NAMES:
        p50, p99, worst = 1e3 * np.percentile(results[name]["ages"], [50, 99, 100])
        figures[name] = {"p50 / ms": p50, "p99 / ms": p99, "largest / ms": worst, "share heard": results[name]["heard"]}
    for name, values in figures.items():
        print(name)
        for key, value in values.items():
            print(f"  {key:<22}{value:.4g}")
    if arguments.picture:
        draw(results, arguments.picture)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
