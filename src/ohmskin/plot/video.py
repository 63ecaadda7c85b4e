"""Images of several moments: side by side, and one after the other as a video."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ohmskin.contacts import Contact
from ohmskin.errors import DataError
from ohmskin.forward import TransferModel
from ohmskin.geometry import Raster
from ohmskin.plot.picture import PIXELS, draw_image, full_scale
from ohmskin.sensing import Percept

_INCHES, _DPI = (6.4, 5.6), 100


def side_by_side(percepts: Mapping[str, tuple[TransferModel, Percept]]) -> Figure:
    """Images with their contacts, each under its title, each with colours of its own."""
    figure = Figure(figsize=(1 + 4.2 * len(percepts), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(percepts), squeeze=False)[0]
    for axes, (title, (model, percept)) in zip(panels, percepts.items(), strict=True):
        limit = full_scale(percept)
        shown = draw_image(axes, model.mesh, percept.image.values, model.electrodes, percept.detections, limit)
        axes.set_title(title, fontsize=10)
        figure.colorbar(shown, ax=axes, label="relative conductivity change", shrink=0.8)
    return figure


class VideoFigure:
    """One figure, whose image and contacts are exchanged from picture to picture; colours stay fixed.

    Args:
        model, percept: What the first picture shows.
        limit: Value of full colour.
    """

    def __init__(self, model: TransferModel, percept: Percept, limit: float) -> None:
        self._figure = Figure(figsize=_INCHES, dpi=_DPI, layout="constrained")
        FigureCanvasAgg(self._figure)
        self._axes = self._figure.add_subplot()
        self._mesh, self._raster = model.mesh, Raster(model.mesh, PIXELS)
        self._shown = draw_image(self._axes, model.mesh, percept.image.values, model.electrodes, limit=limit)
        self._figure.colorbar(self._shown, ax=self._axes, label="relative conductivity change", shrink=0.85)
        (self._marks,) = self._axes.plot([], [], "+", color="black", markersize=12)

    def show(self, model: TransferModel, percept: Percept, contacts: tuple[Contact, ...], title: str) -> None:
        """Draw the next picture."""
        if model.mesh is not self._mesh:  # after another calibration
            self._mesh, self._raster = model.mesh, Raster(model.mesh, PIXELS)
        self._shown.set_data(self._raster(percept.image.values))
        places = 1e3 * np.array([contact.position for contact in contacts]).reshape(-1, 2)
        self._marks.set_data(places[:, 0], places[:, 1])
        self._axes.set_title(title, fontsize=10)

    @contextmanager
    def written(self, path: Path, rate: float) -> Iterator[Callable[[], None]]:
        """A function that adds the picture as it is to an MP4 file, through ffmpeg, of so many pictures a second."""
        writer = FFMpegWriter(rate, extra_args=["-f", "mp4", "-pix_fmt", "yuv420p"])  # type: ignore[arg-type]
        with writer.saving(self._figure, str(path), _DPI):
            yield writer.grab_frame


def check_video() -> None:
    """Raise DataError unless videos can be made here."""
    if not FFMpegWriter.isAvailable():
        raise DataError("a video needs ffmpeg; install it: apt-get install ffmpeg; or choose png, csv, npz or parquet")
