"""``ohmskin scan``, ``check-device``, ``check-host``: one frame, and whether device or host do as they must."""

import json as json_module
import sys
from dataclasses import asdict
from typing import Self

import numpy as np
from rich.console import Console
from rich.table import Table

from ohmskin.arrays import as_plain
from ohmskin.cli.options import DeviceUrl, Flag, ModeName, Names, Seed, SkinName, Stop, open_skin
from ohmskin.device import connect
from ohmskin.device.conformance import Check
from ohmskin.device.conformance import check_device as run_checks
from ohmskin.device.hostile import PROTOCOL_FAULTS, HostileDevice
from ohmskin.device.virtual import VirtualInstrument
from ohmskin.errors import OhmskinError
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin


def scan(*, device: DeviceUrl = "virtual:", skin: SkinName = "", mode: ModeName = "", json: Flag = False) -> None:
    """Scan a device once with the base pattern of a mode and print the measurements.

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
        url: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE, or that of an installed driver.
        json: Print JSON instead of lines.
    """
    with _Report(json) as report:
        run_checks(connect(url), report)


def check_host(
    *,
    skin: SkinName = "paper",
    host: str = "127.0.0.1",
    port: int = 7155,
    seed: Seed = 0,
    quiet_frames: int = 200,
    timeout: float = 10.0,
    only: Names = (),
    json: Flag = False,
) -> None:
    """Serve a virtual skin that injects faults, and report whether the host that connects recovers.

    The host must scan again after each fault by itself, over a new connection if necessary; a host that ends may be
    started again. The exit status is 1 if it did not.

    Args:
        host: Address to listen at.
        port: TCP port; 0 takes a free one.
        quiet_frames: Frames that the host gets before the first fault, such as those for its calibration.
        timeout: Time after a fault within which the host must request frames again (s).
        only: Names of the faults to inject; all unless given.
        json: Print JSON instead of lines.
    """
    if unknown := sorted(set(only) - set(PROTOCOL_FAULTS)):
        raise OhmskinError(f"no fault {unknown[0]!r}; choose from {', '.join(PROTOCOL_FAULTS)}")
    stop, instrument = Stop(), VirtualInstrument(Skin.load(skin), seed)
    with HostileDevice(instrument, host, port, seed or 0, quiet_frames) as device, _Report(json) as report:
        print(f"device that injects faults at {device.url}: connect the host to check", file=sys.stderr, flush=True)
        stop.listen()
        device.check_host(
            {name: PROTOCOL_FAULTS[name] for name in only or PROTOCOL_FAULTS}, timeout, report, lambda: bool(stop)
        )


class _Report(list[Check]):
    """Prints checks as they come, or all as JSON at the end; the exit status is 1 if one failed."""

    def __init__(self, json: bool) -> None:
        super().__init__()
        self._json = json

    def __call__(self, check: Check) -> None:
        self.append(check)
        if not self._json:
            print(check, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        failed = sum(check.outcome == "failed" for check in self)
        if kind is None:
            plain = json_module.dumps([asdict(check) for check in self])
            print(plain if self._json else f"{len(self)} checks, {failed} failed")
            if failed:
                sys.exit(1)
