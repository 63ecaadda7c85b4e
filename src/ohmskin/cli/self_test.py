"""``ohmskin self-test``: every electrode, noise, offset, linearity, settling and link."""

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ohmskin.calibrate import self_test as run_self_test
from ohmskin.cli.options import Flag, SkinName, check_picture, make_folder, open_skin
from ohmskin.skin import Fault
from ohmskin.skin.files import write


def self_test(
    *,
    device: str = "virtual:",
    skin: SkinName = "",
    output: Path | None = None,
    json: Flag = False,
    fault: tuple[str, ...] = (),
) -> None:
    """Test the wiring and the instrument of an untouched skin. Keep it untouched meanwhile.

    The exit status is 1 if an electrode is faulty.

    Args:
        device: Address: virtual:, tcp://HOST:PORT, serial://PORT.
        output: Folder for self-test.json and self-test.png.
        json: Print JSON instead of a table.
        fault: With virtual: only: fault of the wiring, such as "open 3", "short 7 8", "swap 1 2" or "high 5
            20".
    """
    if output is not None:
        make_folder(output)
        check_picture(output / "self-test.png")
    console = Console(highlight=False, soft_wrap=True)
    opened, description = open_skin(device, skin, [Fault.parse(text) for text in fault])
    with opened:
        notify = (lambda _: None) if json else (lambda text: print(f"{text} ...", file=sys.stderr))
        result = run_self_test(opened, description, notify)
    if json:
        print(result.to_json())
    else:
        for finding in result.findings or [f"all {len(description.electrodes)} electrodes are in order"]:
            console.print(str(finding))
        for remark in result.remarks:
            console.print(f"note: {remark}")
        table = Table("measured", "value", box=None)
        for row in result.table():
            table.add_row(*row)
        if table.rows:
            console.print(table)
    if output is not None:
        from ohmskin.plot.calibration import save_self_test  # here: it needs the extra `plot`

        write(output / "self-test.json", result.to_json() + "\n")
        save_self_test(output / "self-test.png", result, description)
    if result.findings:
        sys.exit(1)
