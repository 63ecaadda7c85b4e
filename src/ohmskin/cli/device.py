"""``ohmskin scan`` and ``check-device``: one frame as it comes from a device, and whether it does what each must."""

import json as json_module
import sys
from dataclasses import asdict

import numpy as np
from rich.console import Console
from rich.table import Table

from ohmskin.arrays import as_plain
from ohmskin.cli.options import DeviceUrl, Flag, ModeName, SkinName, open_skin
from ohmskin.device import connect
from ohmskin.device.conformance import check_device as run_checks
from ohmskin.sensing import drive_of, mode_named


def scan(*, device: DeviceUrl = "virtual:", skin: SkinName = "", mode: ModeName = "", json: Flag = False) -> None:
    """Scan a device once with the base pattern of a mode and print what it measured.

    Args:
        json: Print JSON instead of a table.
    """
    opened, description = open_skin(device, skin)
    with opened:
        drive = drive_of(mode_named(description, mode), description)
        pattern = opened.reference[0].pattern if opened.reference else drive.next((), 0)
        frame = opened.scan(pattern)
    if json:
        driven = {"injections": pattern.injections, "measurements": pattern.measurements}
        measured = {"currents": frame.currents, "voltages": frame.voltages}
        print(json_module.dumps(as_plain({"device": device, **driven, **measured})))
        return
    table = Table("source", "sink", "plus", "minus", "current / mA", "voltage / mV", box=None)
    for row in np.column_stack([pattern.quadruples, frame.measurement_currents, frame.voltages]):
        table.add_row(*(str(int(number)) for number in row[:4]), f"{row[4] * 1e3:.4f}", f"{row[5] * 1e3:.3f}")
    Console().print(table)


def check_device(url: str, *, json: Flag = False) -> None:
    """Check a device and its driver; keep the skin untouched meanwhile. The exit status is 1 if a check fails.

    Args:
        url: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE, or that of a driver that is installed.
        json: Print JSON instead of lines.
    """
    checks = run_checks(connect(url), lambda check: None if json else print(check, flush=True))
    failed = sum(check.outcome == "failed" for check in checks)
    print(json_module.dumps([asdict(check) for check in checks]) if json else f"{len(checks)} checks, {failed} failed")
    if failed:
        sys.exit(1)
