"""``ohmskin info``: what is installed and what is there."""

import platform

import numpy
import scipy
from rich.console import Console
from serial.tools import list_ports

import ohmskin
from ohmskin.device import drivers
from ohmskin.skin import Skin, shipped_skins


def info() -> None:
    """Show versions, the skins that ship, drivers and serial ports."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(
        f"ohmskin {ohmskin.__version__}, Python {platform.python_version()}, NumPy {numpy.__version__}, SciPy {scipy.__version__}"
    )
    console.print("\nskins")
    for name in shipped_skins():
        skin = Skin.load(name)
        console.print(f"  {name:<14}{len(skin.electrodes)} electrodes, modes {', '.join(skin.modes)}")
    console.print("\ndevices")
    for scheme in sorted(drivers()):
        console.print(f"  {scheme}:")
    ports = sorted(port.device for port in list_ports.comports())
    console.print(f"\nserial ports\n  {', '.join(ports) or 'none found'}")
