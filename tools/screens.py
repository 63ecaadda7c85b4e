"""Screenshots of the pages in all their states, sizes and themes, to be looked at."""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from ohmskin.view import LiveView

SIZES = {320: 640, 390: 844, 1024: 768, 1440: 900, 1920: 1080}
PHONE = 500  # px of width, below which it is a phone
THEMES = ("light", "dark")
BODY = """
name = "screens"
[[patch]]
name = "upper"
link = "upper_arm"
device = "virtual:"
[[patch]]
name = "fore"
link = "forearm"
device = "virtual:"
"""
ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
TORSO = ("chest", "back", "left_arm", "right_arm", "left_fore", "right_fore", "belly", "head")
FRAME = "window.ohmskin.frame"
UNSEEN = ("--no-browser", "--port", "0")  # options of a page that no browser of the user opens


@contextmanager
def running(*arguments: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """The address that a command of ohmskin prints first, and its process."""
    command = [sys.executable, "-m", "ohmskin", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    try:
        pattern = r"tcp://\S+" if arguments[0] == "serve-skin" else r"http://\S+"
        told = ""
        while not (found := re.search(pattern, told)):
            if not (line := process.stdout.readline()):
                raise SystemExit(f"ohmskin {arguments[0]} ended: {told}")
            told += line
        yield found[0], process
    finally:
        process.terminate()
        process.communicate()


@contextmanager
def chromium() -> Iterator[Browser]:
    """The browser of this machine, without a window."""
    found = map(shutil.which, ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"))
    if not (path := next(filter(None, found), None)):
        raise SystemExit("no Chromium on the PATH: apt-get install chromium")
    with sync_playwright() as play:
        yield play.chromium.launch(executable_path=path, args=["--no-sandbox"])


class Screens:
    """Two browsers at a page, a desktop and a phone: the desktop presses, both are photographed.

    Args:
        chromium: The browser.
        folder: Where the pictures go.
        wanted: States to photograph; all if none is named.
        widths: Widths of the window (px), out of `SIZES`.
    """

    def __init__(self, chromium: Browser, folder: Path, wanted: set[str], widths: list[int]) -> None:
        self._chromium, self._folder, self._wanted, self._widths = chromium, folder, wanted, widths
        self.made: list[Path] = []

    def open(self, url: str, condition: str = f"{FRAME}?.patches || {FRAME}?.state === 'running'") -> Page:
        """Go to a page with both, and wait until a condition is true of it."""
        phone = self._chromium.new_context(has_touch=True, is_mobile=True, viewport={"width": 390, "height": 844})
        self.desk, self.phone = self._chromium.new_context().new_page(), phone.new_page()
        for page in (self.desk, self.phone):
            page.goto(url)
            until(page, condition)
        self.desk.set_viewport_size({"width": 1440, "height": 900})
        return self.desk

    def close(self) -> None:
        for browser in self._chromium.contexts:
            browser.close()

    def take(self, state: str) -> None:
        """Photograph a state in all sizes and themes."""
        if self._wanted and state not in self._wanted:
            return
        for width in self._widths:
            page = self.phone if width < PHONE else self.desk
            page.set_viewport_size({"width": width, "height": SIZES[width]})
            for theme in THEMES:
                page.evaluate(f"document.documentElement.dataset.theme = '{theme}'")
                page.wait_for_timeout(500)
                self.made.append(self._folder / f"{state}-{width}-{theme}.png")
                page.screenshot(path=self.made[-1], full_page=True)
        self.desk.set_viewport_size({"width": 1440, "height": 900})

    def picture(self, name: str, theme: str, size: tuple[int, int] = (1440, 900), when: str = "true") -> None:
        """A picture of the documentation: what a desktop of that size (px) shows, at a moment of that condition."""
        self.desk.set_viewport_size({"width": size[0], "height": size[1]})
        self.desk.evaluate(f"document.documentElement.dataset.theme = '{theme}'; document.activeElement.blur()")
        self.desk.mouse.move(1, 1)
        self.desk.wait_for_timeout(8000)  # until figures and scale have settled
        until(self.desk, when)
        self.made.append(IMAGES / name)
        self.desk.screenshot(path=self.made[-1])

    def press(self, *places: tuple[float, float]) -> None:
        """Leave presses at places on the sheet (m) until `lift`."""
        self.desk.wait_for_timeout(200)
        box = self.desk.locator("#map").bounding_box()
        assert box is not None
        scale = (box["width"] - 60) / 0.2
        self.desk.keyboard.down("Shift")
        for x, y in places:
            self.desk.mouse.click(box["x"] + 30 + scale * x, box["y"] + box["height"] - 46 - scale * y)
        self.desk.keyboard.up("Shift")
        until(self.desk, f"{FRAME}.contacts.length === {len(places)}")

    def lift(self) -> None:
        self.desk.click("#clear")
        until(self.desk, f"{FRAME}.contacts.length === 0")


def until(page: Page, condition: str, seconds: float = 300.0) -> None:
    for _ in range(round(10 * seconds)):
        if page.evaluate(f"Boolean({condition})"):
            return
        page.wait_for_timeout(100)
    raise SystemExit(f"{condition} did not come true within {seconds:g} s at {page.url}")


def live(screens: Screens, stack: ExitStack, recording: Path) -> None:
    address, skin = stack.enter_context(running("serve-skin", "--port", "0", "--seed", "1"))
    url, _ = stack.enter_context(running("live", "--no-demo", *UNSEEN, "--device", address, "--record", str(recording)))
    page = screens.open(url)
    page.wait_for_timeout(5000)  # until the scale has settled
    screens.take("quiet")
    for each in (page, screens.phone):
        each.click("#help")
    screens.take("help")
    for each in (page, screens.phone):
        each.keyboard.press("Escape")
        each.evaluate("document.activeElement.blur()")
    for each in (page, screens.phone):
        each.click("#guided")
        each.click("#guide-on")
        until(each, "document.getElementById('guide').dataset.step === 'press'")
    screens.take("guide")
    for each in (page, screens.phone):
        each.click("#guide-close")
        each.evaluate("document.activeElement.blur()")
    screens.press((0.06, 0.13))
    screens.take("one")
    screens.lift()
    screens.press((0.045, 0.05), (0.15, 0.06), (0.1, 0.16))
    screens.take("three")
    page.click('[data-mode="16T"]')
    until(page, f"{FRAME}.mode === '16T' && {FRAME}.contacts.length === 3")
    page.wait_for_timeout(1500)
    screens.take("tracking")
    page.click('[data-mode="12B"]')
    until(page, f"{FRAME}.mode === '12B' && {FRAME}.contacts.length > 0")
    page.wait_for_timeout(1500)
    screens.take("fixed")
    page.click('[data-mode="16T"]')
    until(page, f"{FRAME}.mode === '16T'")
    for each in (page, screens.phone):
        each.click("#expert summary")
    screens.take("expert")
    skin.terminate()
    until(page, f"{FRAME}.state === 'lost'")
    screens.take("lost")


def starting(screens: Screens, stack: ExitStack, recording: Path) -> None:
    view = stack.enter_context(LiveView(port=0))
    view.starting("compiling, once on this machine; 12 functions in 9 s", 0.43)
    screens.open(view.url, "document.getElementById('state').textContent === 'starting'")
    screens.take("starting")


def doubt(screens: Screens, stack: ExitStack, recording: Path) -> None:
    address, _ = stack.enter_context(running("serve-skin", "--port", "0", "--seed", "1", "--fault", "open 6"))
    url, _ = stack.enter_context(running("live", "--no-demo", *UNSEEN, "--device", address))
    screens.open(url)
    screens.press((0.06, 0.13))
    screens.take("doubt")


def newtons(screens: Screens, stack: ExitStack, recording: Path) -> None:
    calibrated = str(recording.with_name("calibrated.toml"))
    presses = ("--places", "2", "--weights", "200", "700")
    subprocess.run([sys.executable, "-m", "ohmskin", "calibrate", *presses, "--output", calibrated], check=True)
    address, skin = stack.enter_context(running("serve-skin", "--port", "0", "--seed", "1", "--skin", calibrated))
    url, _ = stack.enter_context(running("live", "--no-demo", *UNSEEN, "--device", address, "--skin", calibrated))
    page = screens.open(url)
    screens.press((0.06, 0.13))
    until(page, f"{FRAME}.contacts[0]?.force && {FRAME}.gesture?.name === 'push'")
    screens.take("newtons")
    skin.terminate()
    until(page, f"{FRAME}.state === 'lost'")
    screens.take("newtons-lost")


def replay(screens: Screens, stack: ExitStack, recording: Path) -> None:
    url, _ = stack.enter_context(running("replay", str(recording), *UNSEEN))
    page = screens.open(url)
    page.wait_for_timeout(3000)
    screens.take("replay")
    page.locator("#seek").focus()
    page.keyboard.press("End")
    until(page, f"{FRAME}.recording.ended && {FRAME}.state === 'paused'")
    screens.take("replay-end")


def body(screens: Screens, stack: ExitStack, recording: Path) -> None:
    described = recording.with_name("body.toml")
    described.write_text(BODY)
    url, _ = stack.enter_context(running("patches", str(described), *UNSEEN))
    page = screens.open(url)
    until(page, f"{FRAME}.patches.every((patch) => patch.age !== null)")
    page.wait_for_timeout(3000)
    screens.take("body")
    screens.desk.goto(f"{url}#fore")
    screens.phone.goto(f"{url}#fore")
    screens.take("patch")


def robot(screens: Screens, stack: ExitStack, recording: Path) -> None:
    url, _ = stack.enter_context(running("patches", str(ROOT / "examples/body/body.toml"), "--demo", *UNSEEN))
    until(screens.open(url), f"{FRAME}.patches.some((patch) => patch.contacts.length)")
    screens.take("robot")


def electrodes(screens: Screens, stack: ExitStack, recording: Path) -> None:
    saved = str(recording.with_name("electrodes.toml"))
    url, _ = stack.enter_context(running("electrodes", "--skin", "sleeve", "--save", saved, *UNSEEN))
    screens.open(url, "document.querySelectorAll('#electrodes li').length === 16")
    screens.take("electrodes")


def docs(screens: Screens, stack: ExitStack, recording: Path) -> None:
    url, _ = stack.enter_context(running("live", "--no-demo", *UNSEEN))
    page = screens.open(url)
    screens.phone.close()  # one viewer is enough
    screens.press((0.06, 0.13), (0.14, 0.06))
    screens.picture("live.png", "light")
    page.click('[data-mode="16T"]')
    until(page, f"{FRAME}.mode === '16T' && {FRAME}.contacts.length === 2")
    screens.picture("live-tracking.png", "dark")
    screens.close()
    _patches_of_docs(screens, stack, recording.with_name("torso.toml"))
    screens.close()
    url, _ = stack.enter_context(running("patches", str(ROOT / "examples/body/body.toml"), "--demo", *UNSEEN))
    until(screens.open(url), f"{FRAME}.patches.every((patch) => patch.contacts.length)")
    before = "document.querySelectorAll('#labels [data-kind=contact]:not([hidden])').length >= 2"
    screens.picture("guide/body.png", "light", (1180, 640), before)


def _patches_of_docs(screens: Screens, stack: ExitStack, described: Path) -> None:
    """Eight patches that demonstration fingers press; the device of the last one is lost."""
    address, head = stack.enter_context(running("serve-skin", "--port", "0", "--seed", "1"))
    devices = dict.fromkeys(TORSO, "virtual:") | {TORSO[-1]: address}
    tables = (f'[[patch]]\nname = "{name}"\nlink = "{name}_link"\ndevice = "{at}"\n' for name, at in devices.items())
    described.write_text('name = "torso"\n' + "".join(tables))
    url, _ = stack.enter_context(running("patches", str(described), "--demo", *UNSEEN))
    page = screens.open(url, f"{FRAME}?.patches?.every((patch) => patch.age !== null)")
    until(page, f"{FRAME}.patches.filter((patch) => patch.contacts.length).length >= 5")
    head.terminate()
    until(page, f"{FRAME}.patches.at(-1).age > 1")
    screens.picture("guide/patches.png", "light", (1330, 880))


SCENES: dict[Callable[[Screens, ExitStack, Path], None], set[str]] = {
    live: {"quiet", "help", "guide", "one", "three", "tracking", "fixed", "expert", "lost"},
    starting: {"starting"},
    doubt: {"doubt"},
    newtons: {"newtons", "newtons-lost"},
    replay: {"replay", "replay-end"},
    body: {"body", "patch"},
    robot: {"robot"},
    electrodes: {"electrodes"},
    docs: {"docs"},
}


def main(folder: Path, wanted: set[str], widths: list[int]) -> list[Path]:
    """The pictures that were made."""
    folder.mkdir(parents=True, exist_ok=True)
    with chromium() as browser, tempfile.TemporaryDirectory() as scratch:
        screens = Screens(browser, folder, wanted, widths)
        for scene, states in SCENES.items():
            needed = scene is live and wanted & SCENES[replay]  # which it records
            if wanted & states or needed or not (wanted or scene is docs):
                with ExitStack() as stack:
                    scene(screens, stack, Path(scratch) / "touch.mcap")
                    screens.close()
    return screens.made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("screens"), help="folder for the pictures")
    parser.add_argument("--widths", type=int, nargs="+", choices=SIZES, default=list(SIZES), help="of the window (px)")
    parser.add_argument("states", nargs="*", help="all of them unless named; docs makes the documentation's")
    chosen = parser.parse_args()
    if unknown := set(chosen.states).difference(*SCENES.values()):
        parser.error(f"no state {', '.join(unknown)}; choose from {', '.join(sorted(set().union(*SCENES.values())))}")
    made = main(chosen.output, set(chosen.states), chosen.widths)
    print(f"{len(made)} pictures in {chosen.output}")
