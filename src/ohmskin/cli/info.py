"""``ohmskin info``: what is installed and what there is to choose from."""

import platform

import numpy
import scipy
from rich.console import Console
from serial.tools import list_ports

import ohmskin
from ohmskin.device import drivers
from ohmskin.drive import DRIVES
from ohmskin.inverse import PRIORS
from ohmskin.inverse.choice import RULES
from ohmskin.inverse.estimators import ESTIMATORS
from ohmskin.sensing import READERS, default_mode, modes
from ohmskin.skin import Skin, shipped_skins


def info() -> None:
    """Show versions, skins and their modes, drives, readers, estimators, priors, rules, drivers and serial ports."""
    console = Console(highlight=False, soft_wrap=True, markup=False)
    versions = f"Python {platform.python_version()}, NumPy {numpy.__version__}, SciPy {scipy.__version__}"
    console.print(f"ohmskin {ohmskin.__version__}, {versions}")
    console.print("\nskins (--skin) and their modes (--mode); * marks the default")
    for name in shipped_skins():
        skin = Skin.load(name)
        console.print(f"  {name}, {len(skin.electrodes)} electrodes")
        for mode in modes(skin).values():
            console.print(f"  {'*' if mode.name == default_mode(skin) else ' '} {mode.name:<5} {mode.title}".rstrip())
    for table, use in (
        (DRIVES, "drives, of modes in skin files"),
        (READERS, "readers, of modes in skin files"),
        (ESTIMATORS, "estimators (--estimator)"),
    ):
        console.print(f"\n{use}")
        for name in table:
            console.print(f"  {name:<20}{table.title(name)}")
    console.print(f"\npriors (--prior)\n  {', '.join(PRIORS)}")
    console.print(f"\nrules for the regularisation parameter (--rule)\n  {', '.join(RULES)}")
    console.print(f"\ndevices (--device)\n  {', '.join(f'{scheme}:' for scheme in sorted(drivers()))}")
    ports = sorted(port.device for port in list_ports.comports())
    console.print(f"\nserial ports\n  {', '.join(ports) or 'none found'}")
