"""Pictures of the demonstration: the arm as MuJoCo draws it, and beside it what the skin feels."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

from ohmskin.errors import ModelError
from ohmskin.geometry import Raster
from ohmskin.robot.arm import Arm
from ohmskin.robot.demonstration import Moment
from ohmskin.robot.display import mujoco, renderer
from ohmskin.skin import Skin

_SIDE = 480  # pixels of each half
_RATE = 30  # pictures per second of film


class Film:
    """Draws moments side by side: arm left, skin right.

    Args:
        skin: The skin.
        arm: The arm that wears it.

    Raises:
        ModelError: If MuJoCo cannot draw on this machine.
    """

    def __init__(self, skin: Skin, arm: Arm) -> None:
        self._renderer = renderer(arm.model, _SIDE, _SIDE)
        self._raster = Raster(skin.mesh(), 64)
        figure = Figure(figsize=(_SIDE / 100, _SIDE / 100), dpi=100)
        self._canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.09, 0.09, 0.86, 0.82))
        x, y, half = self._raster.x, self._raster.y, self._raster.pitch / 2
        extent = (1e3 * (x[0] - half), 1e3 * (x[-1] + half), 1e3 * (y[0] - half), 1e3 * (y[-1] + half))
        empty = np.zeros(self._raster.inside.shape)
        self._picture = axes.imshow(empty, origin="lower", extent=extent, cmap="magma", vmin=0)
        axes.plot(*(1e3 * skin.electrodes.positions.T), ".", color="#9aa5b5", markersize=7)
        (self._truth,) = axes.plot([], [], "o", color="#6fd3ff", markersize=26, fillstyle="none", label="true contact")
        self._truth.set_markeredgewidth(2)
        (self._felt,) = axes.plot([], [], "+", color="white", markersize=22, markeredgewidth=3, label="sensed contact")
        axes.set_xlabel("mm")
        axes.legend(loc="lower right", framealpha=0.3, labelcolor="white", facecolor="black", markerscale=0.4)
        self._title = figure.text(0.09, 0.94, "", fontsize=15)

    def draw(self, moment: Moment, scale: float = 0.6) -> np.ndarray:
        """A picture (480, 960, 3), uint8; `scale` is the relative change shown brightest, at least."""
        arm = moment.arm
        self._renderer.update_scene(arm.data, "view")
        for contact in moment.touch.contacts[:1]:
            self._mark(arm.to_world(np.array(contact.position)))
        pixels = np.nan_to_num(self._raster(moment.touch.percept.image.values))
        self._picture.set_data(pixels)
        self._picture.set_clim(0, max(scale, float(pixels.max())))
        self._truth.set_data(*(1e3 * moment.poke.position[:, None] if moment.poke else ([], [])))
        places = np.array([c.position for c in moment.touch.contacts[:1]]).reshape(-1, 2)
        self._felt.set_data(*(1e3 * places.T))
        force = f"{moment.poke.force:4.1f} N" if moment.poke else "no contact"
        self._title.set_text(f"{moment.time:5.2f} s    {force}")
        self._canvas.draw()
        right = np.asarray(self._canvas.buffer_rgba())[..., :3]
        return np.hstack([self._renderer.render(), right])

    def close(self) -> None:
        """Let go of the renderer."""
        self._renderer.close()

    def _mark(self, place: np.ndarray) -> None:
        scene = self._renderer.scene
        size, colour = np.full(3, 0.012), np.array([0.1, 0.85, 0.45, 1.0], np.float32)
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], sphere, size, place, np.eye(3).ravel(), colour)
        scene.ngeom += 1


@contextmanager
def snapshot(path: Path, film: Film) -> Iterator[Callable[[Moment], None]]:
    """A PNG file of the moment of largest force among those shown with a sensed contact; none if there is none.

    Raises:
        ModelError: At the end, if the file cannot be written.
    """
    best, picture = 0.0, np.zeros(0)

    def show(moment: Moment) -> None:
        nonlocal best, picture
        if moment.poke is not None and moment.touch.contacts and moment.poke.force > best:
            best, picture = moment.poke.force, film.draw(moment)

    try:
        yield show
    finally:
        if picture.size:
            try:
                imsave(path, picture, format="png")
            except OSError as error:
                raise ModelError(f"cannot write {path}: {error.strerror}; choose another place") from error


@contextmanager
def video(path: Path, film: Film) -> Iterator[Callable[[Moment], None]]:
    """An MP4 file of the moments shown, written by ffmpeg as they come; simulated time at its true speed.

    Raises:
        ModelError: If ffmpeg is not installed or, at the end, the file cannot be written.
    """
    if (ffmpeg := shutil.which("ffmpeg")) is None:
        raise ModelError("a video needs ffmpeg; install it: apt install ffmpeg")
    raw = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {2 * _SIDE}x{_SIDE} -r {_RATE} -i -"
    command = [ffmpeg, *raw.split(), *["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p"], str(path)]
    process, due = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE), 0.0
    stdin = cast(IO[bytes], process.stdin)

    def show(moment: Moment) -> None:
        nonlocal due
        if due <= moment.time:
            picture = film.draw(moment).tobytes()
            while due <= moment.time:
                stdin.write(picture)
                due += 1 / _RATE

    try:
        yield show
    finally:
        said = process.communicate()[1].decode(errors="replace").strip()
        if process.returncode:  # which is also why a picture could not be written
            raise ModelError(f"ffmpeg failed: {said.splitlines()[-1] if said else 'it does not say why'}")
