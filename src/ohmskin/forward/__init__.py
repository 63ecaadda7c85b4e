"""From conductivity to voltages: finite elements, electrode models, excitations, calibration, sensitivity."""

from ohmskin.forward.calibration import BackgroundFit, fit_background
from ohmskin.forward.excitation import Response, VoltageSource, drive_currents, drive_voltages
from ohmskin.forward.patches import FloatingPatches
from ohmskin.forward.response import ContactResponse, ContactTable
from ohmskin.forward.touches import TouchTable
from ohmskin.forward.transfer import TransferModel
from ohmskin.forward.update import LocalUpdate

__all__ = [
    "BackgroundFit",
    "ContactResponse",
    "ContactTable",
    "FloatingPatches",
    "LocalUpdate",
    "Response",
    "TouchTable",
    "TransferModel",
    "VoltageSource",
    "drive_currents",
    "drive_voltages",
    "fit_background",
]
