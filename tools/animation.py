"""The animation of README.md: a finger on the real page, and one on the page of a body, in headless Chromium.

    python tools/animation.py [FILE.webp]

The finger moves a step, then the page is photographed, so that the picture does not depend on how busy the machine is;
played, a second shows what took the finger some three seconds.
"""

import io
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page
from screens import FRAME, IMAGES, chromium, running, until

ROOT = Path(__file__).parents[1]
SIZE, WIDTH, STEP, MILLISECONDS = {"width": 1440, "height": 900}, 880, 200, 90  # px, px, ms, ms


def photographed(page: Page, path: np.ndarray) -> Iterator[Image.Image]:
    """Press along a path (n, 2) of pixels; what the page looks like at each place."""
    page.mouse.move(*path[0])
    page.mouse.down()
    for place in path:
        page.mouse.move(*place)
        page.wait_for_timeout(STEP)
        yield Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    page.mouse.up()


def opened(stack: ExitStack, url: str, condition: str) -> Page:
    """A page, as soon as a condition is true of it."""
    page = stack.enter_context(chromium()).new_page(viewport=SIZE)
    page.goto(url)
    until(page, condition)
    return page


def finger(stack: ExitStack) -> Iterator[Image.Image]:
    """A finger that wanders over the virtual skin, in the mode that tracks."""
    url, _ = stack.enter_context(running("live", "--no-browser", "--no-demo", "--port", "0"))
    page = opened(stack, url, f"{FRAME}?.state === 'running'")
    page.click('[data-mode="16T"]')
    until(page, f"{FRAME}.mode === '16T'")
    box = page.locator("#map").bounding_box()
    assert box is not None
    turn = np.linspace(0, 2 * np.pi, 45)
    x, y = 0.1 + 0.06 * np.sin(turn), 0.1 + 0.05 * np.sin(2 * turn)  # m
    scale = (box["width"] - 60) / 0.2
    yield from photographed(
        page, np.column_stack([box["x"] + 30 + scale * x, box["y"] + box["height"] - 46 - scale * y])
    )


def body(stack: ExitStack) -> Iterator[Image.Image]:
    """A finger that strokes the robot of `examples/body`."""
    url, _ = stack.enter_context(
        running("patches", str(ROOT / "examples/body/body.toml"), "--no-browser", "--port", "0")
    )
    page = opened(stack, url, f"{FRAME}?.patches?.every((patch) => patch.age !== null)")
    page.wait_for_timeout(4000)
    box = page.locator("#space").bounding_box()
    assert box is not None
    places = []
    for turn in np.linspace(0, 2 * np.pi, 40):  # on the axis of the forearm's sleeve: what is before it is pressed
        at = [0.02 * float(np.sin(turn)), 0.0, -0.12 - 0.05 * float(np.cos(turn))]
        place = page.evaluate("([link, at]) => ohmskin.body.place(link, at)", ["forearm", at])
        places.append((box["x"] + place["x"], box["y"] + place["y"]))
    yield from photographed(page, np.array(places))


def main(path: Path) -> None:
    """Make the animation."""
    pictures = []
    for scene in (finger, body):
        with ExitStack() as stack:
            for picture in scene(stack):
                pictures.append(
                    picture.resize((WIDTH, WIDTH * picture.height // picture.width), Image.Resampling.LANCZOS)
                )
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=MILLISECONDS, loop=0, quality=55, method=3
    )
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES / "touch.webp")
