"""From conductivity to voltages: finite elements, electrode models, sensitivity."""

from ohmskin.forward.transfer import TransferModel

__all__ = ["TransferModel"]
