"""The guided calibration of newtons: presses of known force on a live skin, saved with its description."""

from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np

import ohmskin
from ohmskin.calibrate import ForceSampler, fit_newtons
from ohmskin.engine import Engine, Touch
from ohmskin.errors import DataError

_SETTLE, _CYCLES = 2, 6  # of each press; the guide holds it for 0.7 s, and slow machines make some 13 frames a second
_MOST = 100  # presses


class GuidedForces:
    """Takes a sample of each press whose force the page knows.

    Args:
        engine: The loop.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.begin()

    def begin(self) -> None:
        """Forget all samples."""
        self._presses, self._force = ForceSampler(_MOST, _SETTLE, _CYCLES), float("nan")

    def set_force(self, force: float) -> None:
        """From now on the skin is pressed with a force (N); 0: it is not, or nobody knows with which."""
        self._force = force or float("nan")

    def add(self, touch: Touch) -> None:
        """Look at a cycle."""
        if np.isnan(self._force) or self._presses.done or (known := self._engine.known) is None:
            return
        frames = touch.percept.frames
        beside = frames[-1].auxiliary
        scans = tuple(map(known.difference, frames))
        self._presses.add(touch.contacts, scans, self._force, np.nan if beside is None else beside)

    def save(self, folder: Path = Path()) -> str:
        """Write the skin's description with what the presses say of newtons to a new file; says what was found.

        Raises:
            DataError: If fewer than two forces were detected, or the file cannot be written.
        """
        skin, known = self._engine.skin, self._engine.known
        if known is None:
            raise DataError("the skin is not calibrated; measure the quiet skin first")
        before = skin.calibration
        if not before.date:
            before = before.made_now(skin.digest, ohmskin.__version__)
        found, _, words = fit_newtons(replace(before, mode=self._engine.mode.name), self._presses, known)
        names = (f"{skin.name}-calibrated{f'-{k}' if k > 1 else ''}.toml" for k in count(1))
        path = next(path for name in names if not (path := folder / name).exists())
        try:
            path.write_text(replace(skin, calibration=found).dump(), encoding="utf-8")
        except OSError as error:
            text = f"cannot write {path}: {error}; start ohmskin in a folder that can be written to"
            raise DataError(text) from error
        return f"{'; '.join(words)}. Force calibration saved in {path.absolute()}; use it with --skin {path.name}"
