"""What several commands share; what some of them need is imported where it is used, so that others start sooner."""

import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from ohmskin.child import when_input_ends
from ohmskin.cli.heartbeat import HEARTBEAT, interrupt
from ohmskin.device import Device, connect
from ohmskin.device.registry import scheme_of
from ohmskin.errors import DataError, ModelError, OhmskinError, SkinError, ViewError
from ohmskin.skin import Fault, Skin, shipped_skins
from ohmskin.skin.files import save_skin
from ohmskin.view.live import check_address

if TYPE_CHECKING:
    from ohmskin.recording.player import Replayed

DeviceUrl = Annotated[str, Parameter(help="Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE.")]
SkinName = Annotated[str, Parameter(help="A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.")]
ModeName = Annotated[
    str, Parameter(help="A mode of the skin, such as 16P or 12B (see `ohmskin info`); the default mode unless given.")
]
Demo = Annotated[
    bool, Parameter(help="Let a demonstration finger move over a virtual skin; on the page, until somebody presses.")
]
Lifeline = Annotated[bool, Parameter(show=False)]  # whether to end when standard input ends
Jobs = Annotated[int | None, Parameter(help="Processes; one per core unless given.")]
Scheduler = Annotated[str, Parameter(help="Address of a Dask scheduler to run on instead, such as tcp://host:8786.")]
Numbers = Annotated[tuple[float, ...], Parameter(consume_multiple=True)]  # --noise 45 35 55
Names = Annotated[tuple[str, ...], Parameter(consume_multiple=True)]  # --only static pairs
Flag = Annotated[bool, Parameter(negative="")]  # off unless given
Repeated = Annotated[tuple[str, ...], Parameter(consume_multiple=False)]  # --publish shm --publish zenoh


def _positive(_: object, seconds: float | None) -> None:
    if seconds is not None and not seconds > 0:
        raise OhmskinError(f"--seconds is {seconds:g}; it must be positive")


def check_seed(_: object, seed: int | None) -> None:
    """Raise unless noise can be made of this seed."""
    if seed is not None and not 0 <= seed < 2**63:
        raise OhmskinError(f"--seed is {seed}; it must be 0 to 2^63 - 1")


Seed = Annotated[int | None, Parameter(help="Seed of the noise, to make it repeatable.", validator=check_seed)]
Seconds = Annotated[
    float | None, Parameter(help="End after this time (s); at Ctrl-C unless given.", validator=_positive)
]


@dataclass(frozen=True)
class _Imaging:
    """How images are made.

    Args:
        estimator: Estimator of the image, such as kalman or total-variation (see `ohmskin info`); the mode's
            unless given.
        prior: Prior of the estimator, such as paper or matern; the mode's unless given.
        rule: Rule for the regularisation parameter, such as physical or l-curve; the mode's unless given.
    """

    estimator: str = ""
    prior: str = ""
    rule: str = ""

    def __post_init__(self) -> None:
        if not (self.estimator or self.prior or self.rule):
            return
        from ohmskin.inverse import PRIORS
        from ohmskin.inverse.choice import RULES
        from ohmskin.inverse.estimators import ESTIMATORS, check_choice

        for option, table in (("estimator", ESTIMATORS), ("prior", [*PRIORS, "pixels"]), ("rule", RULES)):
            if (name := getattr(self, option)) and name not in table:
                raise ModelError(f"no {option} {name!r}; choose from {', '.join(table)}")
        check_choice(self.estimator or "gauss-newton", self.prior or "paper", self.rule or "physical")


Imaging = Annotated[_Imaging, Parameter(name="*")]
"""The options ``--estimator``, ``--prior`` and ``--rule``, checked before anything is opened."""

AS_THE_MODE = _Imaging()


@dataclass(frozen=True)
class _Page:
    """Where a page is served.

    Args:
        host: Address to serve the page at; one that others can reach needs a token.
        port: Port of the page; if it is taken, the next free one.
        token: Password, a part of the page's address.
        browser: Open the page in a browser if there is a display.
    """

    host: str = "127.0.0.1"
    port: int = 8000
    token: str = ""
    browser: bool = True

    @property
    def address(self) -> tuple[str, int, str | None]:
        """Host, port and token."""
        return self.host, self.port, self.token or None

    def check(self, instead: str = "", published: bool = False) -> None:
        """Raise ViewError unless a page can be served there; asked before the device is opened, which takes a while.

        Where an option `instead` says that there is none, raise OhmskinError if any is given that is for one; outlets
        need a token, too.
        """
        if instead:
            given = {"host": self.host != HERE.host, "port": self.port != HERE.port}
            refuse_unused(f"with {instead}", **given, token=bool(self.token) and not published)
            return
        check_address(*self.address)
        if self != HERE:
            from ohmskin.view.server import listen  # here: its web server takes a while to import

            try:
                listen(self.host, self.port).close()
            except OSError as error:
                raise ViewError(f"the page cannot start: {error}") from error

    def open(self, url: str) -> None:
        """Say where the page is, and show it."""
        say(f"open {url}   (Ctrl-C ends)")
        display = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if self.browser and display:
            webbrowser.open(url)


Page = Annotated[_Page, Parameter(name="*")]
"""The options ``--host``, ``--port``, ``--token`` and ``--browser``."""

HERE = _Page()


class Stop(threading.Event):
    """Set, and true, after Ctrl-C or SIGTERM and, with a `lifeline`, at the end of standard input.

    Until `listen` is called, and when asked twice, either ends the program at once, cleaning up on the way: only a loop
    that runs has something to finish first. If something, such as an import, swallows that, the loop ends as it begins.
    """

    def __init__(self, lifeline: bool = False) -> None:
        super().__init__()
        self._listening = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)
        if lifeline:
            when_input_ends(self.set)

    def listen(self, silent: bool = True) -> None:
        """Take effect from here on, where the command runs until it is stopped; `silent`, without signs of life."""
        if silent:
            HEARTBEAT.end()
        self._listening = True

    def _ask(self, number: int, _: object) -> None:
        at_once = self.is_set() or not self._listening
        self.set()
        if at_once:
            interrupt() if number == signal.SIGINT else sys.exit(0)

    def __bool__(self) -> bool:
        return self.is_set()


def open_skin(
    device: str, skin: str, faults: Sequence[Fault] = (), meanwhile: Callable[[Skin], None] = lambda _: None
) -> tuple[Device, Skin]:
    """Open a device and the description of its skin: the one named, the device's own, or the paper's.

    `meanwhile` is called with the skin while the process of a virtual one starts.

    Raises:
        DeviceError: If there is no driver for the device.
        SkinError: If a real skin is to have `faults`.
    """
    if scheme_of(device) == "virtual":
        description = Skin.load(skin or device.partition(":")[2] or "paper")
        opened = connect("virtual:", skin=description, faults=faults, meanwhile=lambda: meanwhile(description))
        return opened, description
    if faults:
        raise SkinError(f"--fault is for virtual: only; give it to `ohmskin serve-skin` if {device} is one of those")
    from ohmskin.device.replay import ReplayDevice, recorded_skin

    opened = connect(device)
    try:
        if isinstance(opened, ReplayDevice):
            description = recorded_skin(opened, skin)
            for note in opened.recording.notes if opened.recording.positions is not None else ():
                print(f"# {note}", file=sys.stderr)
            return opened, description
        return opened, Skin.load(skin or opened.default_skin)
    except BaseException:
        opened.close()
        raise


def fitting_skin(file: Path, named: str, recorded: str) -> Skin:
    """The skin named, or else the one that fits the format of a recording; raise DataError if there is neither."""
    if not (named or recorded):
        choices = f"a .toml file or {', '.join(shipped_skins())}"
        raise DataError(f"{file} does not name its skin; name it with --skin, {choices}")
    return Skin.load(named or recorded)


def refuse_unused(where: str, **given: object) -> None:
    """Raise OhmskinError if an option of those that have no effect `where` this is so was given."""
    for name in (name for name, value in given.items() if value):
        raise OhmskinError(f"--{name.replace('_', '-')} has no effect {where}; leave it out")


def check_source(device: str, skin: str, mode: str) -> None:
    """Raise OhmskinError if it is plain before a device is opened that it, its skin or the mode cannot be."""
    rest = device.partition(":")[2]
    virtual = scheme_of(device) == "virtual"
    if scheme_of(device) == "replay":
        check_recording(Path(rest.partition("?")[0]))
    described = Skin.load(skin or rest or "paper") if virtual else Skin.load(skin) if skin else None
    if described and scheme_of(device) != "replay":
        from ohmskin.sensing import check_parts, mode_named  # here: help does not need it

        check_parts(mode_named(described, mode))


def check_recording(file: Path) -> None:
    """Raise DataError if there is no such file."""
    if not file.exists():
        raise DataError(f"there is no file {file}; `ohmskin examples` writes two recordings to try")


def refuse_existing(file: Path) -> None:
    """Raise unless a recording can be made here; asked before the device is opened, which takes a while."""
    if file.suffix != ".mcap":
        name = file.with_suffix(".mcap")
        raise OhmskinError(f"{file}: recordings are MCAP files; record to {name}, `ohmskin export` converts them")
    if file.exists():
        raise OhmskinError(f"{file} exists, and a recording is never overwritten; choose another name")
    if not file.absolute().parent.is_dir():
        raise OhmskinError(f"cannot record to {file}: there is no folder {file.absolute().parent}; create it first")


def check_publishing(outlets: Sequence[str], page: _Page, name: str) -> None:
    """Raise OhmskinError if it is plain that something of that name cannot be published to these outlets; asked before
    the device is opened, which takes a while."""
    from ohmskin.client.board import check_name
    from ohmskin.outlets.outlet import check_outlet
    from ohmskin.outlets.publisher import check_settings

    check_name(name)
    check_settings(page.token or None, images=1.0)
    for address in outlets:
        check_outlet(address)
        kind, _, place = address.partition(":")
        if kind == "mcap":
            refuse_existing(Path(place))


def watched(cycles: Iterable["Replayed"]) -> Iterator["Replayed"]:
    """The cycles of a recording, and on the terminal how far they are."""
    with Console(stderr=True).status("reading the recording") as status:
        for cycle in cycles:
            status.update(f"reading the recording: {cycle.time:.1f} s")
            yield cycle


def say(sentence: str) -> None:
    """Print a line and flush it."""
    print(sentence, flush=True)


def write_skin(path: Path, skin: Skin) -> None:
    """Write a skin's file, or raise DataError; one that was there is kept under another name, which is said."""
    if kept := save_skin(path, skin):
        say(f"the {path} that was there is now {kept}")


def make_folder(folder: Path) -> None:
    """Make a folder unless it is there, or raise DataError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot write to {folder}: {error}; choose another folder") from error


def check_writable(path: Path) -> None:
    """Raise DataError if a file cannot be written; checked before anything is computed for it."""
    place = path if path.exists() else path.parent
    if path.is_dir() or not os.access(place, os.W_OK):
        raise DataError(f"cannot write {path}: {place} is {'a folder' if path.is_dir() else 'missing or read-only'}")


def check_plot() -> None:
    """Raise DataError, with the line that installs it, if the extra `plot` is missing; checked before all else."""
    import ohmskin.plot  # noqa: F401 (here: most commands draw nothing)


def check_picture(path: Path) -> None:
    """Raise DataError if a picture cannot be written there, likewise, or the extra `plot` is missing."""
    check_writable(path)
    check_plot()
    from ohmskin.plot.picture import FORMATS  # here: most commands draw nothing

    if path.suffix.lstrip(".") not in FORMATS:
        raise DataError(
            f"cannot write {path}: {path.suffix!r} is not a picture format; choose .png, .pdf, .svg or .jpg"
        )
