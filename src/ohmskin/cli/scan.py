"""``ohmskin scan``: one frame, as it comes from the device."""

import json as json_module
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ohmskin.cli.options import open_skin
from ohmskin.sensing import drive_of, mode_named


def scan(*, device: str = "virtual:", skin: str = "", mode: str = "", json: bool = False) -> None:
    """Scan a device once with the base pattern of a mode and print what it measured.

    Args:
        device: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE.
        skin: A skin that ships with ohmskin or a .toml file.
        mode: Drive mode, such as 12B; that of least measured error unless given.
        json: Print JSON instead of a table.
    """
    opened, description = open_skin(device, skin)
    with opened:
        drive = drive_of(mode_named(description, mode), description)
        pattern = opened.reference[0].pattern if opened.reference else drive.next((), 0)
        frame = opened.scan(pattern)
    rows = np.column_stack([pattern.quadruples, frame.measurement_currents, frame.voltages])
    if json:
        data: dict[str, Any] = {
            "device": device,
            "injections": pattern.injections.tolist(),
            "measurements": pattern.measurements.tolist(),
            "currents": frame.currents.tolist(),
            "voltages": [value if np.isfinite(value) else None for value in frame.voltages.tolist()],
        }
        print(json_module.dumps(data))
        return
    table = Table("source", "sink", "plus", "minus", "current / mA", "voltage / mV", box=None)
    for row in rows:
        table.add_row(*(str(int(number)) for number in row[:4]), f"{row[4] * 1e3:.4f}", f"{row[5] * 1e3:.3f}")
    Console().print(table)
