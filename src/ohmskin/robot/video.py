"""Pictures of the demonstration: the robot as MuJoCo draws it, and beside it what its skins feel."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imsave

from ohmskin.arrays import Floats
from ohmskin.body import PlacedSkin
from ohmskin.errors import ModelError
from ohmskin.geometry import Raster
from ohmskin.plot.colours import GLOWING
from ohmskin.robot.demonstration import Moment
from ohmskin.robot.display import mujoco, renderer
from ohmskin.robot.simulation import RobotSimulation

_SIDE, _LARGE = 480, 720  # pixels of each half: with one skin, with several
_RATE = 30  # pictures per second of film
_SCALE = 0.6  # relative change shown brightest, at least
_SHOWN = 0.15  # relative change from which on a skin in space is coloured
_PER_NEWTON, _LEAST, _MOST = 0.02, 0.06, 0.25  # m, of arrows
_FORCE, _OWN, _TRUE = "#1ad973", "#9d7bff", "#6fd3ff"


class SkinMap:
    """One skin: its map, and its pixels in space.

    Args:
        placed: The skin.
        axes: Where its map is drawn.
        alone: Whether there is no other, so that there is room for a legend and units.
    """

    def __init__(self, placed: PlacedSkin, axes: Axes, alone: bool) -> None:
        skin = placed.skin
        self.raster, self.values = Raster(skin.mesh(), 64 if alone else 48), np.zeros(0)
        x, y, half = self.raster.x, self.raster.y, self.raster.pitch / 2
        extent = (1e3 * (x[0] - half), 1e3 * (x[-1] + half), 1e3 * (y[0] - half), 1e3 * (y[-1] + half))
        empty = np.zeros(self.raster.inside.shape)
        self._picture = axes.imshow(empty, origin="lower", extent=extent, cmap=GLOWING, vmin=0)
        axes.plot(*(1e3 * skin.electrodes.positions.T), ".", color="#9aa5b5", markersize=7 if alone else 3)
        size = 1.0 if alone else 0.5
        truth: dict[str, Any] = {"color": _TRUE, "markersize": 26 * size}
        felt: dict[str, Any] = {"markersize": 22 * size}
        (self._truth,) = axes.plot([], [], "o", fillstyle="none", label="true contact", **truth)
        (self._sensed,) = axes.plot([], [], "+w", markeredgewidth=5 * size, label="sensed contact", **felt)
        if alone:
            axes.set_xlabel("mm")
            look: dict[str, Any] = {"labelcolor": "white", "facecolor": "black", "markerscale": 0.4}
            axes.legend(loc="lower right", framealpha=0.3, **look)
        else:
            axes.set_title(placed.patch.name.replace("_", " "), fontsize=9, pad=3)
            axes.set(xticks=[], yticks=[])
        places = np.stack(np.meshgrid(x, y), axis=-1)[self.raster.inside]
        chart = skin.chart
        self._points = np.array([placed.patch.place(*point) for point in chart.points(places).tolist()])
        self.size = 0.75 * self.raster.pitch * float(np.median(chart.scale(places)))

    def draw(self, number: int, moment: Moment) -> None:
        """Draw what it feels on its map."""
        pixels = np.nan_to_num(self.raster(moment.touches[number].percept.image.values))
        self.values = pixels[self.raster.inside]
        self._picture.set_data(pixels)
        self._picture.set_clim(0, max(_SCALE, float(pixels.max())))
        truth = [1e3 * push.place for push in moment.pushes if push.patch == number]
        felt = [1e3 * np.array(one.place) for one in moment.sensed if one.patch == number]
        self._truth.set_data(*np.reshape(truth, (-1, 2)).T)
        self._sensed.set_data(*np.reshape(felt, (-1, 2)).T)

    def coloured(self, simulation: RobotSimulation, link: str) -> Iterator[tuple[Floats, Floats]]:
        """Points (3,) of the skin in the world where it feels something, and their colours (RGBA)."""
        body = simulation.data.body(link)
        turn, shown = body.xmat.reshape(3, 3), self.values > _SHOWN
        colours = GLOWING(self.values[shown] / max(_SCALE, float(self.values.max(initial=0.0))))
        for point, colour in zip(self._points[shown], colours, strict=True):
            yield body.xpos + turn @ point, colour


class SceneRenderer:
    """Draws moments side by side: robot left, skins right.

    Args:
        simulation: The robot.

    Raises:
        ModelError: If MuJoCo cannot draw on this machine.
    """

    def __init__(self, simulation: RobotSimulation) -> None:
        patches = simulation.body.patches
        self._alone = len(patches) == 1
        side = _SIDE if self._alone else _LARGE
        self.size = 2 * side, side
        self._renderer = renderer(simulation.model, side, side)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(simulation.model, self._camera)
        figure = Figure(figsize=(side / 100, side / 100), dpi=100)
        self._canvas = FigureCanvasAgg(figure)
        self._title = figure.text(0.09, 0.94, "", fontsize=15)
        if self._alone:
            places = [figure.add_axes((0.09, 0.09, 0.86, 0.82))]
        else:
            rows = -(-len(patches) // 2)
            grid = figure.add_gridspec(rows, 2, left=0.05, right=0.97, bottom=0.02, top=0.89, hspace=0.3)
            places = [figure.add_subplot(grid[number // 2, number % 2]) for number in range(len(patches))]
        pairs = zip(patches, places, strict=True)
        self._maps = [SkinMap(placed, axes, self._alone) for placed, axes in pairs]

    def draw(self, moment: Moment) -> np.ndarray:
        """A picture (480, 960, 3), of several skins (720, 1440, 3), uint8."""
        simulation = moment.simulation
        self._renderer.update_scene(simulation.data, self._camera)
        for number, (own, placed) in enumerate(zip(self._maps, simulation.body.patches, strict=True)):
            own.draw(number, moment)
            for point, colour in own.coloured(simulation, placed.patch.frame):
                self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, own.size), point, colour)
        for one in moment.sensed:
            self._arrow(one.contact.position, one.contact.normal, one.contact.force, bool(one.contact.self_touch))
        outside = [push for push in moment.pushes if not push.by]
        true = sum(push.force for push in outside)
        told = f"{true:4.1f} N" if outside else "self-touch" if moment.pushes else "no contact"
        forces = [one.contact.force for one in moment.sensed if one.push in outside and one.contact.force is not None]
        told += f", {sum(forces):4.1f} N felt" if forces else ""
        told += f", on {len(outside)} skins" if len(outside) > 1 else ""
        self._title.set_text(f"{moment.time:5.2f} s    {told}")
        self._canvas.draw()
        right = np.asarray(self._canvas.buffer_rgba())[..., :3]
        return np.hstack([self._renderer.render(), right])

    def faces(self, normal: tuple[float, ...]) -> float:
        """How far (-1 to 1) a surface with this outward normal in the world faces who looks."""
        turn, up = np.radians([self._camera.azimuth, self._camera.elevation])
        return float(-np.dot(normal, [np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)]))

    def close(self) -> None:
        """Let go of the renderer."""
        self._renderer.close()

    def _arrow(self, at: tuple[float, ...], normal: tuple[float, ...], force: float | None, own: bool) -> None:
        """An arrow onto a contact, as long as it is strong; another colour where the robot touches itself."""
        tip, length = np.array(at), _LEAST if force is None else min(_MOST, max(_LEAST, _PER_NEWTON * force))
        colour = np.array(to_rgba(_OWN if own else _FORCE))
        self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.016), tip, colour)
        geom = self._add(mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), tip, colour)
        if geom is not None:
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, 0.008, tip + length * np.array(normal), tip)

    def _add(self, kind: Any, size: Floats, point: Floats, colour: Floats) -> Any:
        """A shape in the scene, if there is room for more."""
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, point, np.eye(3).ravel(), np.asarray(colour, np.float32))
        scene.ngeom += 1
        return geom


@contextmanager
def snapshot(path: Path, scene_renderer: SceneRenderer) -> Iterator[Callable[[Moment], None]]:
    """A PNG file of the moment of largest force among those with a sensed contact, best in view; none if there is none.

    Raises:
        ModelError: At the end, if the file cannot be written.
    """
    best, picture = 0.0, np.zeros(0)

    def show(moment: Moment) -> None:
        nonlocal best, picture
        shares = [
            (one.push.force, scene_renderer.faces(one.contact.normal)) for one in moment.sensed if one.push is not None
        ]
        felt = max((force * (1.1 + facing) for force, facing in shares), default=0.0)
        if felt > best:
            best, picture = felt, scene_renderer.draw(moment)

    try:
        yield show
    finally:
        if picture.size:
            try:
                imsave(path, picture, format="png")
            except OSError as error:
                raise ModelError(f"cannot write {path}: {error.strerror}; choose another place") from error


@contextmanager
def video(path: Path, scene_renderer: SceneRenderer) -> Iterator[Callable[[Moment], None]]:
    """An MP4 file of the moments shown, written by ffmpeg as they come; simulated time at its true speed.

    Raises:
        ModelError: If ffmpeg is not installed or, at the end, the file cannot be written.
    """
    if (ffmpeg := shutil.which("ffmpeg")) is None:
        raise ModelError("a video needs ffmpeg; install it: apt-get install ffmpeg")
    width, height = scene_renderer.size
    raw = f"-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {_RATE} -i -"
    command = [ffmpeg, *raw.split(), *["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p"], str(path)]
    process, due = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE), 0.0
    stdin = cast(IO[bytes], process.stdin)

    def show(moment: Moment) -> None:
        nonlocal due
        if due <= moment.time:
            picture = scene_renderer.draw(moment).tobytes()
            while due <= moment.time:
                stdin.write(picture)
                due += 1 / _RATE

    try:
        yield show
    finally:
        said = process.communicate()[1].decode(errors="replace").strip()
        if process.returncode:  # which is also why a picture could not be written
            raise ModelError(f"ffmpeg failed: {said.splitlines()[-1] if said else 'no reason given'}")
