"""The command line: each command is imported when it is called."""

import gc
import os
import re
import signal
import sys
from contextlib import AbstractContextManager, nullcontext
from difflib import get_close_matches
from typing import Any

# Small dense solves are slower with several BLAS threads than with one, and they would take the virtual skin's core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from cyclopts import App, CycloptsError, Group, Parameter

import ohmskin
from ohmskin.cli.heartbeat import HEARTBEAT, INTERRUPTED, interrupt
from ohmskin.errors import OhmskinError, harmless
from ohmskin.registry import naming

_TOGETHER = {
    **dict.fromkeys(("scan", "check-device", "check-host"), "device"),
    **dict.fromkeys(("serve-skin", "serve-firmware"), "serve"),
    **dict.fromkeys(("reproduce", "policies"), "studies"),
    "record": "loop",
}
_COMMANDS = {
    "Sense": {
        "live": ("Sense touches, live in the browser or on the terminal.", "ohmskin live --headless --seconds 10"),
        "patches": ("Sense with several skins of one robot.", "ohmskin patches body.toml --publish zenoh"),
        "info": ("Show versions, skins and modes, estimators, drivers and serial ports.", "ohmskin info"),
    },
    "Recordings": {
        "record": ("Record a device to a file.", "ohmskin record touch.mcap --seconds 10"),
        "replay": ("Replay a recording, or compare estimators on it.", "ohmskin replay touch.mcap --speed 2 --loop"),
        "image": ("Make a picture of a recording.", "ohmskin image recordings/touch.csv --output touch.png"),
        "export": ("Export a recording as tables, arrays, pictures or a video.", "ohmskin export touch.mcap --to csv"),
        "examples": ("Write two small recordings to try these commands on.", "ohmskin examples"),
        "recover": ("Repair a truncated recording.", "ohmskin recover touch.mcap"),
    },
    "Build a skin": {
        "layout": (
            "Map the Cramer-Rao bound of a contact's position error, or find a better layout.",
            "ohmskin layout --optimise 16",
        ),
        "electrodes": (
            "Place electrodes by clicking on the skin.",
            "ohmskin electrodes --skin sleeve --save my-sleeve.toml",
        ),
        "pattern": ("Draw the cutting pattern of a skin, 1:1.", "ohmskin pattern --skin sleeve --output sleeve.pdf"),
        "self-test": ("Test the wiring and the instrument of an untouched skin.", "ohmskin self-test --output out"),
        "calibrate": ("Calibrate a skin: quiet, sheet, contacts, newtons.", "ohmskin calibrate --output my-skin.toml"),
        "learn": (
            "Learn faulty channels and a map of positions from presses.",
            "ohmskin learn presses.csv --skin my-skin.toml --output learned.toml",
        ),
        "scan": ("Scan a device once and print the measurements.", "ohmskin scan --device tcp://127.0.0.1:7155"),
        "check-device": ("Check a device and its driver.", "ohmskin check-device tcp://127.0.0.1:7155"),
        "check-host": ("Check a host: serve a device that injects faults.", "ohmskin check-host --port 7155"),
    },
    "Virtual skin": {
        "serve-skin": ("Serve a virtual skin over TCP and a pseudo-terminal.", "ohmskin serve-skin --pty"),
        "serve-firmware": ("Run the board's firmware in QEMU on a virtual skin.", "ohmskin serve-firmware"),
        "press": ("Press a virtual skin that is served.", "ohmskin press 50 120 --seconds 3 --to 150 120"),
        "robot": ("Poke a simulated robot arm that wears the skin.", "ohmskin robot --pokes 5 --picture arm.png"),
        "dataset": ("Simulate touches for learning.", "ohmskin dataset touches.zarr --count 1000"),
    },
    "Studies": {
        "reproduce": ("Reproduce the paper: every figure and table, in one report.", "ohmskin reproduce --quick"),
        "policies": ("Compare drive policies with the paper's.", "ohmskin policies --quick"),
        "bench": ("Measure speed against other software and the machine's limits.", "ohmskin bench --quick"),
    },
}


def _shown(default: Any) -> Any:
    """A default as help shows it; None where there is nothing to show."""
    if isinstance(default, bool) or default in ("", ()):
        return None
    return " ".join(f"{value:g}" for value in default) if isinstance(default, tuple) else default


app = App(
    name="ohmskin",
    help="A sense of touch from a few electrodes. Start with: `ohmskin live`\n\n"
    "Exit status: 0 done, 1 a check found a fault, 2 an error, reported in one line, 130 interrupted (Ctrl-C) before "
    "it was done.",
    version=ohmskin.__version__,
    result_action="return_value",
    default_parameter=Parameter(negative_iterable=(), show_default=_shown),
)
for _group, _commands in _COMMANDS.items():
    _panel = Group.create_ordered(_group)
    for _number, (_name, (_help, _example)) in enumerate(_commands.items()):
        _function = _name.replace("-", "_")
        _spec = f"ohmskin.cli.{_TOGETHER.get(_name, _function)}:{_function}"
        app.command(_spec, name=_name, group=_panel, sort_key=_number, help=f"{_help}\n\nExample: `{_example}`")
app.register_install_completion_command(help="Install completion for your shell, or `--shell` bash, zsh or fish.")
_OPTIONS = Group.create_ordered("Options")
for _name in ("--help", "--version", "--install-completion"):
    app[_name].group = _OPTIONS


def main() -> None:
    """Run the command line. A mistake of the user gets one line on stderr and exit status 2."""
    arguments = [re.sub(r"^--out(?=$|=)", "--output", argument) for argument in sys.argv[1:]]  # its name until 0.1
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with HEARTBEAT:
        try:
            _run(arguments)
        except (OhmskinError, CycloptsError) as error:
            if _caused_by_interrupt(error):
                sys.exit(130)
            print(f"ohmskin: {error}", file=sys.stderr)
            sys.exit(2)
        except BrokenPipeError:  # the reader of our output, `head` say, has gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(0)
        except OSError as error:  # such as a file name that is too long
            print(f"ohmskin: {harmless(str(error))}", file=sys.stderr)
            sys.exit(2)
        except (Exception, KeyboardInterrupt) as error:  # C code and imports make others of an interrupt
            if not (INTERRUPTED.is_set() or _caused_by_interrupt(error)):
                raise
            sys.exit(130)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)


def _caused_by_interrupt(error: BaseException | None) -> bool:
    return error is not None and (isinstance(error, KeyboardInterrupt) or _caused_by_interrupt(error.__cause__))


def _run(arguments: list[str]) -> None:
    INTERRUPTED.clear()
    _check_command(arguments)
    gc.disable()  # what is imported stays: to look for garbage among it takes a tenth of the time
    try:
        command, bound, _ = app.parse_args(arguments, exit_on_error=False, print_error=False)
    finally:
        gc.enable()
    signal.signal(signal.SIGINT, interrupt)
    with _compiling(), naming(whoever=True):
        command(*bound.args, **bound.kwargs)


def _compiling() -> AbstractContextManager[None]:
    """Says on stderr that functions are being compiled, if the command has any."""
    if "numba" not in sys.modules:
        return nullcontext()
    from ohmskin.compiler import compiling, take_turns  # here: numba takes a while to import

    take_turns()
    return compiling(lambda sentence: print(sentence, file=sys.stderr, flush=True))


def _check_command(arguments: list[str]) -> None:
    """Raise OhmskinError if there is no such command; cyclopts would import them all to say so."""
    if arguments and not arguments[0].startswith("-") and arguments[0] not in app:
        close = get_close_matches(arguments[0], app, 1)
        hint = f"did you mean {close[0]}?" if close else "`ohmskin --help` lists the commands"
        raise OhmskinError(f"no command {arguments[0]!r}; {hint}")
