"""What a mode needs that takes a while to compute, is kept, and depends on the description of a skin alone."""

import numpy as np

from ohmskin.drive import Target
from ohmskin.sensing import drive_of, mode_named
from ohmskin.skin import Skin


def prepare(skin: Skin, mode: str = "") -> None:
    """Make what a mode needs that follows from the description of a skin alone: its model and the tables of its drive.

    Raises:
        PatternError: If there is no such mode, or the skin does not allow it.
    """
    model, drive = skin.transfer_model(), drive_of(mode_named(skin, mode), skin)
    target = Target(model.mesh.centroids[:, :2].mean(axis=0), 1e-6 * np.eye(2), 1e-4, skin.imaging.mesh_size)
    drive.next([target] if drive.patterns else [], 1)
