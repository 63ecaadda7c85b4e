"""Which driver serves which address."""

import inspect
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from ohmskin.device.driver import Device
from ohmskin.errors import DeviceError, OhmskinError

GROUP = "ohmskin.devices"
DRIVERS = {
    "replay": "ohmskin.device.replay:ReplayDevice",
    "serial": "ohmskin.device.wire:WireDevice",
    "tcp": "ohmskin.device.wire:WireDevice",
    "virtual": "ohmskin.device.virtual:VirtualDevice",
}


def drivers() -> dict[str, str]:
    """Scheme and `module:callable` of each driver, of ohmskin and of installed packages (group ohmskin.devices)."""
    return {**{entry.name: entry.value for entry in entry_points(group=GROUP)}, **DRIVERS}


def scheme_of(url: str) -> str:
    """What an address begins with; raises DeviceError if there is no driver for it."""
    scheme, colon, _ = url.partition(":")
    known = drivers()
    if not colon or scheme not in known:
        schemes = ", ".join(f"{name}:" for name in sorted(known))
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
    known, scheme = drivers(), scheme_of(url)
    try:
        return _opened(EntryPoint(scheme, known[scheme], GROUP), url, options)
    except OhmskinError:
        raise
    except Exception as error:  # whatever another package may raise
        if scheme in DRIVERS:
            raise
        why = f"{type(error).__name__}: {error}"
        raise DeviceError(f"{url}: the driver {known[scheme]} cannot open it: {why}; ask who made it") from error


def _opened(driver: EntryPoint, url: str, options: dict[str, Any]) -> Device:
    opener: Callable[..., Device] = driver.load()
    parameters = list(inspect.signature(opener).parameters.values())[1:]
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        allowed = [parameter.name for parameter in parameters]
        if unknown := sorted(options.keys() - set(allowed)):
            raise DeviceError(f"{driver.name}: has no option {unknown[0]!r}; it takes {', '.join(allowed) or 'none'}")
    return opener(url, **options)
