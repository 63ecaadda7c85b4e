"""Which driver serves which address."""

import inspect
from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

from ohmskin.device.driver import Device
from ohmskin.errors import DeviceError
from ohmskin.registry import Registry

GROUP = "ohmskin.devices"
_OWN = {
    "replay": "ohmskin.device.replay:ReplayDevice",
    "serial": "ohmskin.device.wire:WireDevice",
    "tcp": "ohmskin.device.wire:WireDevice",
    "virtual": "ohmskin.device.virtual:VirtualDevice",
}
DRIVERS: Registry[str | Callable[..., Device]] = Registry("driver", GROUP, _OWN, DeviceError, Device)
"""Drivers by scheme: ours as `module:callable`."""


def drivers() -> dict[str, str]:
    """Scheme and `module:callable` of each driver, of ohmskin and of installed packages (group ohmskin.devices)."""
    return {**{entry.name: entry.value for entry in DRIVERS.offered}, **_OWN}


def scheme_of(url: str) -> str:
    """What an address begins with; raises DeviceError if there is no driver for it."""
    scheme, colon, _ = url.partition(":")
    if not colon or scheme not in DRIVERS:
        schemes = ", ".join(f"{name}:" for name in sorted(DRIVERS))
        raise DeviceError(f"no driver for {url!r}; an address begins with one of {schemes}")
    return scheme


def connect(url: str, **options: Any) -> Device:
    """Open the device at `url`, e.g. `tcp://127.0.0.1:7155` or `serial:///dev/ttyACM0`.

    Args:
        url: Scheme and address; the scheme chooses the driver.
        options: What this driver takes beside the address.

    Raises:
        DeviceError: If there is no such driver, it has no such option, the address cannot be read, or the driver of
            another package fails.
        DeviceLost: If nothing answers.
    """
    scheme = scheme_of(url)
    driver = DRIVERS[scheme]
    opener: Callable[..., Device] = EntryPoint(scheme, driver, GROUP).load() if isinstance(driver, str) else driver
    parameters = list(inspect.signature(opener).parameters.values())[1:]
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        allowed = [parameter.name for parameter in parameters]
        if unknown := sorted(options.keys() - set(allowed)):
            raise DeviceError(f"{scheme}: has no option {unknown[0]!r}; it takes {', '.join(allowed) or 'none'}")
    device = opener(url, **options)
    device.plugin = DRIVERS.plugin(scheme)
    return device
