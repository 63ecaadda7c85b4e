"""From conductivity to voltages: finite elements, electrode models, sensitivity."""

from ohmskin.forward.excitation import Response, VoltageSource, drive_currents, drive_voltages
from ohmskin.forward.transfer import TransferModel
from ohmskin.forward.update import FloatingPatches, LocalUpdate

__all__ = ["FloatingPatches", "LocalUpdate", "Response", "TransferModel", "VoltageSource", "drive_currents", "drive_voltages"]
