"""``ohmskin check-device``: does a device do what every device must?"""

import json as json_module
import sys
from dataclasses import asdict

from ohmskin.device import connect
from ohmskin.device.conformance import check_device as run_checks


def check_device(url: str, *, json: bool = False) -> None:
    """Check a device and its driver; nothing may touch the skin meanwhile. The exit status is 1 if a check fails.

    Args:
        url: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE, or that of a driver that is installed.
        json: Print JSON instead of lines.
    """
    checks = run_checks(connect(url), lambda check: None if json else print(check, flush=True))
    failed = sum(check.outcome == "failed" for check in checks)
    print(json_module.dumps([asdict(check) for check in checks]) if json else f"{len(checks)} checks, {failed} failed")
    if failed:
        sys.exit(1)
