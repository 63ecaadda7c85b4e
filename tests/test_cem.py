"""The complete electrode model and its excitations against Fourier and Bessel series, limits, finite differences."""

from functools import cache

import numpy as np
import pytest
from scipy.special import ellipk, i0, i1

from ohmskin.errors import GeometryError, ModelError
from ohmskin.forward import TransferModel, VoltageSource, drive_currents, drive_voltages
from ohmskin.geometry import Disc, ElectrodeKind, Electrodes, Mesh, Rectangle, mesh_domain
from ohmskin.scan import DrivePattern, all_pairs, measure_others, skip

S = 1.83e-3  # siemens per square
RADIUS, COUNT, LENGTH = 0.1, 8, 0.03
DISC, SHEET = Disc(RADIUS), Rectangle(0.2, 0.2)


def fourier_cem(z: float, length: float = LENGTH, count: int = COUNT, modes: int = 400, core: float = 0.0, k: float = 0.0) -> np.ndarray:
    """Two-terminal resistances (count, count) of equal rim electrodes on a disc, by Galerkin in Fourier modes of the rim.

    Somersalo, Cheney and Isaacson 1992. Inside the radius `core` times that of the disc the conductivity is (1 + k) / (1 - k) times S.
    """
    n = np.arange(-modes, modes + 1)
    apart = n[:, None] - n
    half = length / (2 * RADIUS)
    window = np.where(apart == 0, 2 * half, 2 * np.sin(apart * half) / np.where(apart == 0, 1, apart))  # about angle 0
    centres = 2 * np.pi * np.arange(count) / count
    everywhere = window * np.where(apart % count == 0, count, 0)
    inner = k * core ** (2.0 * np.abs(n))
    system = np.diag(2 * np.pi * S * np.abs(n) * (1 + inner) / (1 - inner)) + everywhere * RADIUS / z
    row = np.where(n == 0, 2 * half, 2 * np.sin(n * half) / np.where(n == 0, 1, n)) * RADIUS / z
    load = row[:, None] * np.exp(-1j * n[:, None] * centres)
    total = length / z
    grounded = total * np.eye(count) - (load.conj().T @ np.linalg.solve(system, load)).real  # conductances of the electrodes
    r = np.linalg.inv(grounded + total / count)  # constants are in no pair's resistance
    d = np.diag(r)
    return np.asarray(d[:, None] + d - 2 * r)


def pair_resistance(s: np.ndarray) -> np.ndarray:
    d = np.diag(s)
    return np.asarray(d[:, None] + d - 2 * s)


def rim_electrodes(z: float, length: float = LENGTH, count: int = COUNT) -> Electrodes:
    return Electrodes.rim(DISC, count).with_rim_segments(length, z)


def ends(electrodes: Electrodes) -> np.ndarray:
    """Where the rim electrodes of a disc begin and end."""
    angle = np.arctan2(*electrodes.positions.T[::-1])
    half = electrodes.extents / (2 * RADIUS)
    at = np.concatenate([angle - half, angle + half])
    return RADIUS * np.column_stack([np.cos(at), np.sin(at)])


@cache
def disc_mesh(size: float, z: float = 0.01) -> Mesh:
    return mesh_domain(DISC, size, ends(rim_electrodes(z)))


@cache
def mixed() -> TransferModel:
    """Points, discs and rim segments on one uneven sheet, each contact with another impedance."""
    grid = Electrodes.grid(SHEET)
    mesh = mesh_domain(SHEET, 0.012, grid.positions)
    z = np.random.default_rng(1).uniform(0.5, 2.0, 16)
    electrodes = grid.with_discs(5e-3, 1e-4 * z[12:], range(12, 16)).with_rim_segments(0.013, 5e-3 * z[:10], range(10))
    return TransferModel(mesh, electrodes, S * np.random.default_rng(0).uniform(0.5, 2.0, mesh.n_elem))


def random_pattern(seed: int, driven: np.ndarray, n_meas: int = 20) -> DrivePattern:
    """Any pairs of `driven`, voltages anywhere, at driven electrodes, too."""
    rng = np.random.default_rng(seed)
    injections = np.array([rng.choice(driven, 2, replace=False) for _ in range(5)])
    return DrivePattern(
        injections, np.column_stack([np.sort(rng.integers(0, 5, n_meas)), all_pairs(16)[rng.choice(120, n_meas)][:, ::-1]])
    )


AREAS = np.flatnonzero(mixed().electrodes.are_areas)


# --- analytic solutions -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [1e-3, 1e-2, 1.0])
def test_rim_electrodes_on_a_disc_converge_to_the_fourier_series_with_second_order(z: float) -> None:
    exact = fourier_cem(z)
    sizes = np.array([0.0125, 0.00625, 0.003125])
    error = [
        np.linalg.norm(pair_resistance(TransferModel(disc_mesh(size), rim_electrodes(z), S).transfer_resistance) - exact)
        / np.linalg.norm(exact)
        for size in sizes
    ]
    order = np.polyfit(np.log(sizes), np.log(error), 1)[0]
    print(z, error, order)
    assert order == pytest.approx(2, abs=0.35)
    assert error[-1] < 1e-3
