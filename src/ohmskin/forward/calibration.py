"""Conductivity calibration: background and contact impedances from a measured frame of the untouched skin."""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike

from ohmskin.arrays import Floats
from ohmskin.errors import ModelError
from ohmskin.forward.transfer import TransferModel
from ohmskin.scan import DrivePattern

BACKGROUNDS = {"scale": 0, "linear": 1, "quadratic": 2}  # degree of the polynomial that the log-conductivity changes by


@dataclass(frozen=True, eq=False)
class BackgroundFit:
    """A model fitted to a frame of the untouched skin.

    Args:
        model: The model with what was fitted.
        names: (n_params,) of the parameters: "background 0", ..., "contact 3" or "contacts".
        log_values: (n_params,) coefficients of the background's basis; logarithms of factors on contact impedances.
        covariance: (n_params, n_params) of `log_values`.
        residual: Root mean square residual (V).
        rounds: Gauss-Newton steps taken.
    """

    model: TransferModel
    names: tuple[str, ...]
    log_values: Floats
    covariance: Floats
    residual: float
    rounds: int

    @property
    def log_std(self) -> Floats:
        """(n_params,) standard deviations of `log_values`: relative standard deviations of the scaled quantities."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def factors(self) -> Floats:
        """(n_params,) exp(log_values): the factor on the conductivity, for "scale", and on contact impedances."""
        return np.asarray(np.exp(self.log_values))

    def __str__(self) -> str:
        parts = zip(self.names, self.factors, self.log_std, strict=True)
        lines = [f"{name}: factor {factor:.4g} +- {factor * std:.2g}" for name, factor, std in parts]
        return "\n".join([*lines, f"residual {self.residual:.3g} V rms after {self.rounds} rounds"])


def fit_background(
    model: TransferModel,
    pattern: DrivePattern,
    voltages: ArrayLike,
    currents: ArrayLike = 1.0,
    *,
    background: str | ArrayLike = "scale",
    contacts: str = "keep",
    noise: float | None = None,
    max_rounds: int = 30,
) -> BackgroundFit:
    """Fit the untouched skin's conductivity and contact impedances to a frame, by Gauss-Newton in their logarithms.

    Args:
        model: Where to start.
        pattern: What was driven.
        voltages: (n_meas,) measured (V); what is not finite is left out.
        currents: Measured currents, one value or (n_inj,) in amperes.
        background: What the log-conductivity may change by: a constant ("scale"), or a "linear" or "quadratic"
            polynomial in the coordinates, from the skin's middle over half its extent; or a basis (n_elem, n_params).
        contacts: "keep" them, or fit a "common" factor or one for "each", which needs voltages at driven electrodes.
        noise: Standard deviation of a voltage (V); the residual's unless given.
        max_rounds: Gauss-Newton steps at most.

    Raises:
        ModelError: If an option is unknown, the data do not determine a parameter, or the fit does not converge.
    """
    basis, names = _basis(model, background)
    areas = np.flatnonzero(model.electrodes.are_areas)
    own = np.eye(len(model.electrodes))[:, areas]
    kinds = {
        "keep": (own[:, :0], ()),
        "common": (own.sum(axis=1, keepdims=True), ("contacts",)),
        "each": (own, tuple(f"contact {k}" for k in areas)),
    }
    if contacts not in kinds:
        raise ModelError(f"contacts is {contacts!r}; choose from {', '.join(kinds)}")
    if contacts != "keep" and not len(areas):
        raise ModelError("point electrodes have no contact impedance to fit; use contacts='keep', or area electrodes")
    spread, names = kinds[contacts][0], names + kinds[contacts][1]
    measured = np.asarray(voltages, float)
    if measured.shape != (pattern.n_meas,):
        raise ModelError(f"voltages have shape {measured.shape}; the pattern needs ({pattern.n_meas},)")
    if noise is not None and not (np.isfinite(noise) and noise > 0):
        raise ModelError(
            f"noise is {noise} V; it must be positive and finite, or None to estimate it from the residual"
        )
    known = np.isfinite(measured)
    if known.sum() < len(names) + (noise is None):
        raise ModelError(f"{known.sum()} finite voltages do not determine {len(names)} parameters; measure more")

    n_basis, start = basis.shape[1], model
    values, rounds = np.zeros(len(names)), 0
    predicted = model.voltages(pattern, currents)[known]
    while True:
        rounds += 1
        sheet = model.sensitivity(pattern, currents)[known] @ (model.conductivity[:, None] * basis)
        impedances = model.electrodes.contact_impedances[:, None]
        rows = np.hstack([sheet, model.contact_sensitivity(pattern, currents)[known] @ (impedances * spread)])
        _check_rank(rows, names)
        step = np.linalg.lstsq(rows, measured[known] - predicted, rcond=None)[0]
        misfit, share = float(np.linalg.norm(measured[known] - predicted)), 1.0
        if np.linalg.norm(rows @ step) <= max(1e-6 * misfit, 1e-11 * float(np.linalg.norm(measured[known]))):
            break  # all that is left is not of these parameters
        step /= max(1.0, float(np.abs(step).max()))  # at most a factor of e at once
        while True:
            tried = values + share * step
            other = _moved(start, basis @ tried[:n_basis], spread @ tried[n_basis:])
            foreseen = other.voltages(pattern, currents)[known]
            if np.linalg.norm(measured[known] - foreseen) <= misfit * (1 + 1e-9) or share < 1e-4:
                break
            share /= 2
        values, model, predicted = tried, other, foreseen
        if rounds == max_rounds:
            raise ModelError(f"the background did not converge in {max_rounds} rounds; fit less or start closer")
    left = measured[known] - predicted
    spare = max(1, len(left) - len(names))
    variance = float(left @ left) / spare if noise is None else noise**2
    covariance = variance * np.linalg.inv(rows.T @ rows)
    return BackgroundFit(model, names, values, covariance, float(np.sqrt(np.mean(left**2))), rounds)


def _moved(model: TransferModel, log_conductivity: Floats, log_contact: Floats) -> TransferModel:
    if log_contact.any():
        model = model.with_contact_impedances(model.electrodes.contact_impedances * np.exp(log_contact))
    if not log_conductivity.any():
        return model
    return model.with_conductivity(model.conductivity * np.exp(log_conductivity))


def _basis(model: TransferModel, background: str | ArrayLike) -> tuple[Floats, tuple[str, ...]]:
    """The basis (n_elem, n_params) of the log-conductivity and its names."""
    mesh = model.mesh
    if isinstance(background, str):
        if background not in BACKGROUNDS:
            choices = ", ".join(BACKGROUNDS)
            raise ModelError(f"background is {background!r}; choose from {choices}, or give a basis (n_elem, n_params)")
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        x = (mesh.centroids - (low + high) / 2) / ((high - low).max() / 2)
        columns, names = [np.ones(mesh.n_elem)], ["background"]
        for degree in range(1, BACKGROUNDS[background] + 1):
            for axes in combinations_with_replacement(range(x.shape[1]), degree):
                columns.append(x[:, axes].prod(axis=1))
                names.append(f"background {''.join('xyz'[k] for k in axes)}")
        return np.column_stack(columns), tuple(names)
    basis = np.asarray(background, float)
    if basis.ndim != 2 or basis.shape[0] != mesh.n_elem or basis.shape[1] == 0 or not np.isfinite(basis).all():
        raise ModelError(f"background basis has shape {basis.shape}; give finite numbers ({mesh.n_elem}, n_params)")
    return basis, tuple(f"background {k}" for k in range(basis.shape[1]))


def _check_rank(rows: Floats, names: tuple[str, ...]) -> None:
    size = np.linalg.norm(rows, axis=0)
    if (size <= 1e-12 * size.max()).any():
        unseen = names[int(np.argmin(size))]
        raise ModelError(f"the data do not depend on {unseen!r}; measure at driven electrodes, or do not fit it")
    singular, right = np.linalg.svd(rows / size)[1:]
    if singular[-1] < 1e-9 * singular[0]:
        mixed = np.argsort(-np.abs(right[-1]))[:2]
        pair = f"{names[mixed[0]]!r} from {names[mixed[1]]!r}"
        raise ModelError(f"the data do not separate {pair}; measure more, at driven electrodes, too, or fit less")
