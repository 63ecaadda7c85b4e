"""Devices: what they can do, how to reach them, and how to serve one."""

from ohmskin.device.capabilities import Capabilities, Feature
from ohmskin.device.driver import Device
from ohmskin.device.instrument import Instrument
from ohmskin.device.press import PressCommand
from ohmskin.device.registry import connect, drivers
from ohmskin.device.server import DeviceServer
from ohmskin.device.wire import Link

__all__ = [
    "Capabilities",
    "Device",
    "DeviceServer",
    "Feature",
    "Instrument",
    "Link",
    "PressCommand",
    "connect",
    "drivers",
]
