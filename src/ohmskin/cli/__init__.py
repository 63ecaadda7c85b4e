"""The command line: each command is imported when it is called."""

import os
import sys

# Small dense solves are slower with several BLAS threads than with one, and they would take the virtual skin's core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from cyclopts import App

import ohmskin
from ohmskin.errors import OhmskinError

app = App(
    name="ohmskin",
    help="A sense of touch from a handful of electrodes. Start with: `ohmskin live`",
    version=ohmskin.__version__,
    result_action="return_value",
)
_TOGETHER = {
    **dict.fromkeys(("scan", "check-device"), "device"),
    **dict.fromkeys(("serve-skin", "serve-firmware"), "serve"),
    **dict.fromkeys(("reproduce", "policies"), "studies"),
    "record": "loop",
}
for _name, (_help, _example) in {
    "live": ("Sense touches, live in the browser or on the terminal.", "ohmskin live --headless --seconds 10"),
    "patches": ("Sense with several skins of one robot.", "ohmskin patches body.toml --publish zenoh"),
    "serve-skin": ("Serve a virtual skin over TCP and a pseudo-terminal.", "ohmskin serve-skin --pty"),
    "serve-firmware": ("Run the board's firmware in QEMU on a virtual skin.", "ohmskin serve-firmware"),
    "press": ("Press a virtual skin.", "ohmskin press 50 120 --seconds 3 --to 150 120"),
    "scan": ("Scan a device once and print what it measured.", "ohmskin scan --device tcp://127.0.0.1:7155 --mode 12B"),
    "check-device": ("Check a device and its driver.", "ohmskin check-device tcp://127.0.0.1:7155"),
    "self-test": ("Test the wiring and the instrument of an untouched skin.", "ohmskin self-test --out out"),
    "calibrate": ("Calibrate a skin: quiet, sheet, contacts, newtons.", "ohmskin calibrate --out my-skin.toml"),
    "image": ("Make a picture of a recording.", "ohmskin image recording.csv --output picture.png"),
    "record": ("Record a device to a file.", "ohmskin record touch.mcap --seconds 10"),
    "replay": ("Replay a recording, or compare estimators on it.", "ohmskin replay touch.mcap --speed 2 --loop"),
    "recover": ("Mend a recording that was cut short.", "ohmskin recover touch.mcap"),
    "export": ("Export a recording as tables, arrays, pictures or a film.", "ohmskin export touch.mcap --to csv"),
    "reproduce": ("Reproduce the paper: every figure and table, in one report.", "ohmskin reproduce --quick"),
    "policies": ("Compare drive policies with the paper's: what to measure next.", "ohmskin policies --quick"),
    "robot": ("Poke a simulated robot arm that wears the skin.", "ohmskin robot --pokes 5 --picture arm.png"),
    "dataset": ("Simulate touches for learning.", "ohmskin dataset touches.zarr --count 1000"),
    "layout": ("Map how well a skin can locate a contact, or find a better layout.", "ohmskin layout --optimise 16"),
    "bench": ("Measure how fast everything is, beside others and the machine's limits.", "ohmskin bench --quick"),
    "info": ("Show versions, skins and modes, estimators, drivers and serial ports.", "ohmskin info"),
}.items():
    _function = _name.replace("-", "_")
    _module = _TOGETHER.get(_name, _function)
    app.command(f"ohmskin.cli.{_module}:{_function}", name=_name, help=f"{_help}\n\nExample: `{_example}`")


def main() -> None:
    """Run the command line. A mistake of the user gets one line on stderr and exit status 2."""
    try:
        app(sys.argv[1:])
    except OhmskinError as error:
        print(f"ohmskin: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output, `head` say, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
