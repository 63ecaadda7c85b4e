"""A skin that is not its model: what a real one may have, in one call."""

from dataclasses import dataclass, replace

import numpy as np

from ohmskin.arrays import Floats, Ints
from ohmskin.evaluate.flaws import Bumps, misplaced
from ohmskin.forward import TransferModel
from ohmskin.geometry import mesh_domain
from ohmskin.scan import DrivePattern, Frame, adjacent, two_terminal
from ohmskin.skin import Press, PressedSheet, Skin

CURRENT = 1e-3  # A


@dataclass(frozen=True)
class Flawed:
    """Presses of one flawed skin.

    Args:
        skin: As it is described.
        quiet, frames: What was measured.
        positions: (n, 2) of the presses (m).
        silent: Injections that tell nothing.
    """

    skin: Skin
    quiet: list[Frame]
    frames: list[Frame]
    positions: Floats
    silent: Ints

    @property
    def pattern(self) -> DrivePattern:
        """What was driven."""
        return self.frames[0].pattern


def flawed_skin(
    seed: int, presses: int, silent: int = 2, strange: float = 0.1, gain: float = 0.15, drift: float = 0.05
) -> Flawed:
    """Electrodes 3 mm off, a sheet uneven by 20 % and a film by 30 %, gains of channels, a share of them strange,
    injections that tell nothing, and drift."""
    random = np.random.default_rng(seed)
    skin, pattern = Skin.load("paper-rim16"), adjacent([range(16)])
    electrodes = misplaced(skin, 3e-3, random)
    mesh = mesh_domain(skin.domain, 0.8 * skin.imaging.mesh_size, electrodes)
    conductivity = skin.sheet.conductivity * np.exp(0.2 * Bumps(skin.domain, random)(mesh.centroids))
    model = TransferModel(mesh, electrodes, conductivity)
    film = conductivity * np.exp(0.3 * Bumps(skin.domain, random)(mesh.centroids))
    positions = random.uniform(0.01, 0.19, (presses, 2))
    radii, strengths = random.uniform(5e-3, 9e-3, presses), random.uniform(0.5, 1.0, presses)
    inside = ((mesh.centroids - positions[:, None]) ** 2).sum(axis=-1) < radii[:, None] ** 2
    pairs = (strengths[:, None] * inside * film) @ model.pair_sensitivity.T
    changes = (pattern.combination(16) @ pairs.T).T
    gains = 1 + gain * random.standard_normal(pattern.n_meas)
    odd = random.random(pattern.n_meas) < strange
    mixed = changes[:, random.permutation(pattern.n_meas)] * random.uniform(0.5, 2, pattern.n_meas)
    changes = np.where(odd, mixed, gains * changes)
    usual = np.sqrt(np.mean(changes**2))
    none = np.sort(random.choice(16, silent, replace=False))
    off = np.isin(pattern.measurements[:, 0], none)
    changes[:, off] = 0.5 * usual * random.standard_normal((presses, off.sum()))
    return _measured(skin, pattern, gains * model.voltages(pattern), changes, positions, none, usual, drift, random)


def weaker_skin(seed: int, presses: int) -> Flawed:
    """The physics twin with flaws of another kind: electrodes 3 mm off, a sheet uneven by 20 % in stripes and a step,
    a layer that conducts 30 % less, and drift."""
    random = np.random.default_rng([seed, 99])
    skin, pattern = Skin.load("paper-rim16"), adjacent([range(16)])
    electrodes = skin.discs.mapped(lambda _: misplaced(skin, 3e-3, random).positions)
    mesh = skin.mesh_for(electrodes, 0.66 * skin.imaging.mesh_size)
    along, across = (np.array([np.cos(angle), np.sin(angle)]) for angle in random.uniform(0, np.pi, 2))
    stripes = np.sin(2 * np.pi / random.uniform(0.04, 0.12) * mesh.centroids @ along + random.uniform(0, 6.28))
    step = np.sign((mesh.centroids - random.uniform(0.05, 0.15)) @ across)
    uneven = np.exp(0.2 * (np.sqrt(2) * stripes + step) / 2)
    model = TransferModel(mesh, electrodes, skin.sheet.conductivity * uneven)
    layer = replace(skin.contact_layer, conductance=0.7 * skin.contact_layer.conductance)
    sheet = PressedSheet(replace(skin, contact_layer=layer), model=model, contacts=4)
    positions = random.uniform(0.01, 0.19, (presses, 2))
    radii, pressures = random.uniform(5e-3, 9e-3, presses), random.uniform(5e3, 25e3, presses)
    scenes = [[Press((x, y), *how)] for (x, y), *how in zip(positions.tolist(), radii, pressures, strict=True)]
    combination = pattern.combination(16)
    rest, *pressed = (combination @ two_terminal(one, model.pairs) for one in (sheet.untouched, *sheet.many(scenes)))
    changes, none = np.array(pressed) - rest, np.empty(0, np.int64)
    usual = np.sqrt(np.mean(changes**2))
    return _measured(skin, pattern, rest, changes, positions, none, usual, 0.05, random)


def _measured(
    skin: Skin,
    pattern: DrivePattern,
    at_rest: Floats,
    changes: Floats,
    positions: Floats,
    silent: Ints,
    usual: float,
    drift: float,
    random: np.random.Generator,
) -> Flawed:
    """Changes (n, n_meas), `usual` in size, as an instrument that drifts by a share of that measures them (ohm)."""
    wandering = np.cumsum(random.standard_normal(changes.shape), axis=0) / np.sqrt(len(changes))
    changes = changes + usual * (0.01 * random.standard_normal(changes.shape) + drift * wandering)
    shaken = [at_rest + 0.002 * usual * random.standard_normal(pattern.n_meas) for _ in range(10)]
    currents = np.full(pattern.n_inj, CURRENT)
    quiet, frames = (
        [Frame(pattern, CURRENT * volts, currents, time=0.01 * k) for k, volts in enumerate(many)]
        for many in (shaken, at_rest + changes)
    )
    return Flawed(skin, quiet, frames, positions, silent)
