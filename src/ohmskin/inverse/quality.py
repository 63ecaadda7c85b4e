"""How well a quiet frame fits the model of the untouched sheet: its conductivity, a constant error, and what is left.

Reciprocity (`ohmskin.scan.assess`) cannot see an error that all measurements share, such as the converter's offset: a
sheet could be like that. The model can.
"""

from dataclasses import dataclass

import numpy as np

from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.scan import Frame

_UNLIKE = 0.3  # share of the data that fits no scale of the model, above which its description is doubtful
_FAR = 30.0  # factor of the conductivity, either way, that is rather one of units
_OFFSET = 0.2  # constant error, as a share of the data, worth a warning


@dataclass(frozen=True)
class ModelMatch:
    """Result of comparing a quiet frame with the model.

    Args:
        scale: Factor on the model's conductivity (1).
        offset: Voltage that is added to every measurement (V).
        misfit: Residual with scale and offset fitted, as a share of the data (1).
        plain_misfit: The same with the scale alone (1).
        signal: Root mean square of the data (V).
    """

    scale: float
    offset: float
    misfit: float
    plain_misfit: float
    signal: float

    @property
    def doubtful(self) -> bool:
        """Whether these may be data of another skin."""
        return self.misfit > _UNLIKE

    def report(self) -> list[str]:
        """Warnings as sentences; empty if the frame fits."""
        warnings = wrong_units(self.scale)
        if abs(self.offset) > _OFFSET * self.signal and self.misfit < 0.5 * self.plain_misfit:
            share = 100 * abs(self.offset) / self.signal
            added = f"a constant {1e3 * self.offset:.3g} mV seems to be added to every voltage"
            advice = "differences to a reference cancel it, absolute images would not"
            warnings.append(f"{added} ({share:.0f} % of the signal): {advice}")
        if self.doubtful:
            poor = f"{100 * self.misfit:.0f} % of quiet voltages do not fit the skin's description at any conductivity"
            advice = "check the electrodes' order, their start and direction, and the shape"
            warnings.append(f"{poor}; {advice}")
        return warnings


def wrong_units(scale: float) -> list[str]:
    """A warning as a sentence where the described conductivity must be multiplied by a `scale` that is rather one of
    units; empty elsewhere."""
    if 1 / _FAR < abs(scale) < _FAR:
        return []
    factor = f"{1 / abs(scale):.3g} times those of the described conductivity"
    return [f"the voltages are {factor}: check the units of voltages and currents, and the description"]


def match_model(model: TransferModel, frame: Frame) -> ModelMatch:
    """Compare a quiet frame with the model of the untouched sheet.

    Args:
        model: The model; its conductivity may have a wrong scale.
        frame: Of any pattern; what is not finite is left out.

    Raises:
        DataError: If the frame has fewer than three known values.
        PatternError: If it names electrodes that the model does not have.
    """
    modelled = model.voltages(frame.pattern, np.where(np.isfinite(frame.currents), frame.currents, 0.0))
    known = np.isfinite(frame.voltages) & (modelled != 0)
    if known.sum() < 3:
        raise DataError(f"{int(known.sum())} known values cannot be compared with a model; need at least 3")
    modelled, measured = modelled[known], frame.voltages[known]
    both = np.column_stack([modelled, np.ones_like(modelled)])
    scale, offset = np.linalg.lstsq(both, measured, rcond=None)[0]
    plain = float(modelled @ measured / (modelled @ modelled))
    size = float(np.linalg.norm(measured)) or 1.0
    return ModelMatch(
        scale=float(1 / scale) if scale != 0 else float("inf"),
        offset=float(offset),
        misfit=float(np.linalg.norm(measured - both @ [scale, offset])) / size,
        plain_misfit=float(np.linalg.norm(measured - plain * modelled)) / size,
        signal=size / np.sqrt(len(measured)),
    )
