"""How many updates of eight patches arrive at a browser: `python -m benchmarks.updates [--seconds 20]`.

The boards of the eight skins of examples/humanoid are written by this process, each image 50 times a second with a
bump that wanders, as eight loops would; the page's process reads them and sends them to a headless Chromium. Counted
are messages with a new image at the browser's socket, which come only as it answers. There is no GPU: Chromium draws on
the same cores.
"""

import argparse
import os
import shutil
import tempfile
import threading
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from ohmskin.body import Body
from ohmskin.body.body import PlacedSkin
from ohmskin.body.patches import Merger
from ohmskin.client import Board, PatchState
from ohmskin.client.contacts import LARGEST, merged, pack
from ohmskin.geometry import Raster
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.publisher import describe_domain
from ohmskin.view.overview import Overview

BODY = Path(__file__).parents[1] / "examples" / "humanoid" / "body.toml"
WRITTEN = 50.0  # 1/s
PIXELS = 64  # along the longer side, as loops write them
COUNT = """
window.updates = 0;
const Socket = WebSocket;
let last = 0;
const count = ({ data }) => {
  const pixels = new Uint8Array(data, data.byteLength - 16384).reduce((sum, byte) => (31 * sum + byte) | 0, 0);
  if (pixels !== last) window.updates++;
  last = pixels;
};
window.WebSocket = class extends Socket {
  constructor(...given) { super(...given); this.addEventListener("message", count); }
};"""
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


class Written:
    """The boards of one patch, as its loop writes them."""

    def __init__(self, placed: PlacedSkin, board: str, stack: ExitStack) -> None:
        self.patch, self.raster, self.sequence = placed.patch, Raster(placed.skin.mesh(), PIXELS), 0
        told = {"patches": [asdict(self.patch)], "domain": describe_domain(placed.skin)}
        about = told | Picture.setup(self.raster) | Picture.in_space(self.raster, placed.skin.chart, self.patch)
        self.felt = stack.enter_context(Board(board, told, LARGEST))
        self.image = stack.enter_context(Board(f"{board}.image", about, Picture.size(self.raster)))
        self.centres = np.stack(np.meshgrid(self.raster.x, self.raster.y), axis=-1)

    def write(self, now: float) -> None:
        """An image, and that nothing touches."""
        self.sequence += 1
        seen = PatchState(self.patch.name, self.patch.frame, self.sequence, time.monotonic(), time.time_ns(), "16P")
        place = self.centres.mean(axis=(0, 1)) + 0.03 * np.array([np.cos(now), np.sin(now)])
        image = 0.8 * np.exp(-(((self.centres - place) / 0.012) ** 2).sum(axis=-1))
        self.felt.write(pack(merged(self.sequence, [seen], []), [self.patch]))
        self.image.write(Picture.pack(np.where(self.raster.inside, image, np.nan), self.sequence, 0))


def main() -> None:
    """Write, show, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    chosen = parser.parse_args()
    os.environ["OHMSKIN_BOARDS"] = tempfile.mkdtemp()
    body, ended, late = Body.load(BODY), threading.Event(), list[float]()
    assert body.robot is not None
    with ExitStack() as stack:
        names = [f"bench.{placed.patch.name}" for placed in body.patches]
        patches = [Written(placed, name, stack) for placed, name in zip(body.patches, names, strict=True)]
        merger = stack.enter_context(Merger("bench", [one.patch for one in patches], names))

        def write() -> None:
            due = time.monotonic()
            while not ended.is_set():
                for one in patches:
                    one.write(due)
                merger.step()
                due = max(due + 1 / WRITTEN, time.monotonic() - 1 / WRITTEN)
                late.append(time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))

        writer = threading.Thread(target=write)
        writer.start()
        stack.callback(writer.join)
        stack.callback(ended.set)
        overview = stack.enter_context(Overview("bench", names, port=0, robot=body.robot.as_json()))
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium-headless-shell") or shutil.which("chromium"), args=FLAGS
        )
        stack.callback(browser.close)
        page = browser.new_page(viewport={"width": 1200, "height": 800}, bypass_csp=True)
        page.add_init_script(COUNT)
        page.goto(overview.url)
        page.wait_for_function("window.ohmskin?.body?.skins.filter(Boolean).length === 8", timeout=120e3)
        time.sleep(3.0)
        written, before, begun = len(late), page.evaluate("updates"), time.monotonic()
        load = os.getloadavg()[0]
        time.sleep(chosen.seconds)
        seconds, arrived = time.monotonic() - begun, page.evaluate("updates") - before
        rates = arrived / seconds, (len(late) - written) / seconds
        print(f"{rates[0]:.1f} updates of {len(patches)} patches a second at the browser, of {rates[1]:.1f} written")
        print(f"{os.cpu_count()} cores, load {load:.1f} before and {os.getloadavg()[0]:.1f} after")


if __name__ == "__main__":
    main()
