"""The live page as its readers have it: in a real browser, with a synthetic loop behind it."""

import io
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

from ohmskin.view import LiveView

SHEET = {"kind": "rectangle", "width": 0.2, "height": 0.2}
DISC = {"kind": "disc", "radius": 0.1}
MODES = [
    {"name": "12B", "title": "adjacent, 12 rim injections", "available": True, "why_not": ""},
    {"name": "16B", "title": "adjacent, 16 injections", "available": True, "why_not": ""},
    {"name": "16I", "title": "adjacent, 12 + 16 injections", "available": False, "why_not": "needs 4 inner electrodes"},
    {"name": "16O", "title": "adaptive, 12 + 16 injections", "available": True, "why_not": ""},
]


def make_setup(domain: dict[str, Any] = SHEET, pixels: int = 64, virtual: bool = True) -> dict[str, Any]:
    if domain["kind"] == "disc":
        radius = domain["radius"]
        angle = 2 * np.pi * np.arange(16) / 16
        points = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        left, size = -radius, 2 * radius
    else:
        k, side, left, size = np.arange(3) / 3, domain["width"], 0.0, domain["width"]
        rim = [(a * side, 0.0) for a in k] + [(side, a * side) for a in k]
        rim += [(side - a * side, side) for a in k] + [(0.0, side - a * side) for a in k]
        points = np.array(rim + [(side * a, side * b) for a, b in ((1 / 3, 1 / 3), (2 / 3, 1 / 3), (2 / 3, 2 / 3), (1 / 3, 2 / 3))])
    pitch = size / pixels
    return {
        "version": "0.1.0",
        "skin": {
            "name": "tank" if domain["kind"] == "disc" else "paper sheet",
            "domain": domain,
            "electrodes": [{"x": x, "y": y} for x, y in points.tolist()],
        },
        "raster": {"x0": left + pitch / 2, "y0": (domain.get("radius", 0) and left) + pitch / 2, "pitch": pitch, "nx": pixels, "ny": pixels},
        "modes": MODES,
        "device": {"url": "virtual:" if virtual else "tcp://10.0.0.7:7155", "virtual": virtual},
        "unit": "mS",
        "press": {"radius": [0.003, 0.02, 0.008], "pressure": [1e3, 1e5, 2e4]} if virtual else None,
    }


class SyntheticLoop:
    """Stands in for the engine: one bump and one contact per press, commands obeyed and kept."""

    def __init__(self, setup: dict[str, Any], height: float = 1.6, always: tuple[tuple[float, float], ...] = ()) -> None:
        self.setup = setup
        self.height = height
        self.always = always
        self.heard: list[dict[str, Any]] = []
        self.header: dict[str, Any] = {"state": "running", "message": "", "demo": False, "mode": "16O"}
        self.presses: dict[str, dict[str, Any]] = {}
        self.view = LiveView(setup, port=0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.view.close()

    def _run(self) -> None:
        raster = self.setup["raster"]
        x, y = np.meshgrid(*(raster[f"{a}0"] + raster["pitch"] * np.arange(raster[f"n{a}"]) for a in "xy"))
        radius = self.setup["skin"]["domain"].get("radius", np.inf)
        noise = np.random.default_rng(1)
        sequence, start = 0, time.monotonic()
        while not self._stop.wait(0.01):
            sequence += 1
            for command in self.view.commands():
                self.heard.append(command)
                self._obey(command)
            if self.view.wants_frame():
                points = [*self.always, *((p["x"], p["y"]) for p in self.presses.values())]
                image = noise.normal(0, 0.02, x.shape)
                base = noise.normal(0, 0.02, x.shape)
                for k, (px, py) in enumerate(points):
                    sign = -1 if self.height < 0 and k % 2 == 0 else 1
                    squared = (x - px) ** 2 + (y - py) ** 2
                    image += sign * abs(self.height) * (1 - 0.2 * k) * np.exp(-squared / (2 * 0.012**2))
                    base += sign * abs(self.height) * (0.5 - 0.1 * k) * np.exp(-squared / (2 * 0.024**2))
                image[np.hypot(x, y) > radius] = np.nan
                base[np.hypot(x, y) > radius] = np.nan
                self.view.publish(self._header(sequence, time.monotonic() - start, points), base, image)

    def _obey(self, command: dict[str, Any]) -> None:
        match command["type"]:
            case "press":
                self.presses[command["id"]] = command
            case "lift":
                self.presses.pop(command["id"], None)
            case "lift_all":
                self.presses.clear()
            case "mode":
                self.header["mode"] = command["mode"]
            case "pause":
                self.header["state"] = "paused" if command["paused"] else "running"
            case "demo":
                self.header["demo"] = command["on"]

    def _header(self, sequence: int, now: float, points: list[tuple[float, float]]) -> dict[str, Any]:
        contacts = [
            {"id": k + 1, "x": x, "y": y, "extent": 9e-4 * (1 - 0.2 * k), "strength": 1.8e-4 * (1 - 0.2 * k), "confidence": 0.94 - 0.17 * k, "peak": 1.5}
            for k, (x, y) in enumerate(points)
        ]  # fmt: skip
        presses = [{k: p[k] for k in ("id", "x", "y", "radius", "pressure")} | {"demo": False} for p in self.presses.values()]
        health = {
            "rate": 118 + 6 * np.sin(now / 3), "latency_p50": 3.4e-3, "latency_p99": 7.9e-3, "dropped": 0, "noise": 14.2e-6, "waiting": 0.62,
        }  # fmt: skip
        count = len(self.setup["skin"]["electrodes"])
        rim = 12 if self.setup["skin"]["domain"]["kind"] == "rectangle" else count
        adaptive = [[0, 7], [3, 9], [12, 5], [14, 1], [13, 10], [2, 8], [6, 15], [4, 11]] if self.header["mode"] == "16O" and count == 16 else []
        return {
            "sequence": sequence, "time": now, "contacts": contacts, "base_injections": [[k, (k + 1) % rim] for k in range(rim)],
            "injections": adaptive, "presses": presses, "threshold": 0.25, "health": health, **self.header,
        }  # fmt: skip
