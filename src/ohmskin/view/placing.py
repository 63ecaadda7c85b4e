"""The page on which electrodes are placed: who reads it clicks on the skin in space, and the skin file is written."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.arrays import Floats
from ohmskin.child import when_input_ends
from ohmskin.client.contacts import Patch
from ohmskin.closing import Closing
from ohmskin.errors import DataError, OhmskinError
from ohmskin.geometry import Raster
from ohmskin.geometry.electrodes import to_corners
from ohmskin.geometry.periodic import depth, folded, shortest
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.publisher import describe_domain
from ohmskin.skin import Calibration, Skin
from ohmskin.skin.files import save_skin
from ohmskin.view.live import check_address, start_page
from ohmskin.view.server import run, serve_page
from ohmskin.view.wire import to_json

_PIXELS = 96  # along the longer side of the map
_TO_RIM = 1.5  # pixels from a rim, or of it from a corner, within which an electrode is put there
_LARGEST_ANSWER = 96  # bytes
_WORDS = {"click": 3, "place": 2, "remove": 1, "clear": 0, "save": 0}  # what a browser says, and how many numbers


class PlacementPage(Closing):
    """The page, served by a process of its own.

    Args:
        skin: The skin, with the electrodes to begin with.
        target: The skin file that is written when its reader says so.
        host, port, token: As for `LiveView`.

    Attributes:
        url: Where the page is.

    Raises:
        ViewError: If no port is free, or the host is not loopback and there is no token.
    """

    def __init__(
        self, skin: Skin, target: Path, host: str = "127.0.0.1", port: int = 8000, token: str | None = None
    ) -> None:
        check_address(host, port, token)
        settings = {"skin": skin.dump(), "target": str(target)}
        self._child, _, self.url = start_page("ohmskin.view.placing", settings, host, port, token)

    def close(self) -> None:
        self._child.close()


class ElectrodePlacement:
    """Electrodes that are being placed on a skin.

    Args:
        skin: The skin, with the electrodes to begin with.
        target: The skin file to write.
    """

    def __init__(self, skin: Skin, target: Path) -> None:
        self._skin, self._target = replace(skin, calibration=Calibration()), target
        self._raster = Raster(skin.mesh(), _PIXELS)
        self._places: list[Floats] = list(skin.electrodes.positions)
        self._placed: Skin | None = None
        self._note = self._saved = ""
        self._judge()

    def shape(self) -> dict[str, Any]:
        """What the page draws: one link, which is the skin's frame, and where the pixels of the skin are in it (m)."""
        about = Picture.in_space(self._raster, self._skin.chart, Patch())
        points = np.reshape(about["points"], (-1, 3)).tolist()
        inside = self._raster.inside.ravel().tolist()
        return {
            "robot": {"links": {"skin": np.eye(4).ravel().tolist()}, "visuals": []},
            "name": self._skin.name,
            "points": [point if there else None for point, there in zip(points, inside, strict=True)],
            "domain": describe_domain(self._skin),
            "radius": self._skin.electrode.radius,
            "target": str(self._target),
            **Picture.setup(self._raster),
        }

    def state(self) -> dict[str, Any]:
        """Where the electrodes are, on the map and in space (m), and whether they may be saved."""
        places = np.reshape(self._places, (-1, 2))
        chart = self._skin.chart
        normals = chart.frames(places)[:, 2]
        rows = zip(places.tolist(), chart.points(places).tolist(), normals.tolist(), strict=True)
        electrodes = [{"x": x, "y": y, "at": at, "normal": normal} for (x, y), at, normal in rows]
        return {"electrodes": electrodes, "note": self._note, "savable": bool(self._placed), "saved": self._saved}

    def command(self, words: str) -> None:
        """Do what a browser says: ``click X Y Z`` (m, in space), ``place X Y`` (on the map), ``remove N``, ``clear``,
        ``save``.

        Raises:
            ValueError: If that is no such thing.
        """
        kind, *given = words.split()
        numbers = [float(word) for word in given]
        if len(numbers) != _WORDS.get(kind) or not all(abs(number) < 1e3 for number in numbers):
            raise ValueError(f"unknown request: {words!r}")
        self._saved = ""
        if kind == "save":
            return self._save()
        if kind == "remove":
            del self._places[int(numbers[0])]
        elif kind == "clear":
            self._places.clear()
        else:
            place = self._skin.chart.project(numbers)[0][0] if kind == "click" else np.array(numbers)
            if refused := self._add(self._on_rim(place)):
                self._note = refused
                return None
        return self._judge()

    def _on_rim(self, place: Floats) -> Floats:
        """The place, on a rim if one is near."""
        domain = self._skin.domain
        for loop in (domain, *domain.holes):
            reach = _TO_RIM * self._raster.pitch
            edge = loop.rim(to_corners(loop, loop.arc(place[None]), reach))[0]
            if np.linalg.norm(shortest(edge - place, domain.period)) < 1.5 * reach:
                return np.asarray(edge)
        return place

    def _add(self, place: Floats) -> str:
        """Take a place, or say why not."""
        x, y = (1e3 * place).round(1)
        domain = self._skin.domain
        if depth(domain, place[None])[0] < -1e-6:
            x0, y0, x1, y1 = (1e3 * np.array(domain.bounds)).round(1)
            within = f"choose another place, x from {x0} to {x1} mm and y from {y0} to {y1} mm"
            return f"({x}, {y}) mm is off the sheet or in a hole; {within}"
        place = folded(place, domain.period)
        least = 2 * self._skin.electrode.radius / float(self._skin.chart.scale([place])[0])
        for number, other in enumerate(self._places):
            if np.linalg.norm(shortest(place - other, domain.period)) < least:
                return f"({x}, {y}) mm would overlap electrode {number}; choose another place, or remove that"
        self._places.append(place)
        return ""

    def _judge(self) -> None:
        """Make a skin of the electrodes, which numbers them; or say what is missing."""
        count, places = len(self._places), np.reshape(self._places, (-1, 2))
        layout = self._skin.electrode.moved_to(np.round(places, 9))
        pairs = max(1, min(self._skin.imaging.pairs, count * (count - 1) // 2))
        self._placed = None
        try:
            placed = replace(self._skin, electrode=layout, imaging=replace(self._skin.imaging, pairs=pairs))
            placed.mesh_for(placed.discs)
            self._placed, self._places, self._note = placed, list(placed.electrodes.positions), ""
        except OhmskinError as error:
            self._note = str(error)

    def _save(self) -> None:
        if self._placed is None:
            return
        places = np.round(self._placed.electrodes.positions, 9)
        numbered = replace(self._placed, electrode=self._placed.electrode.moved_to(places))
        try:
            kept = save_skin(self._target, numbered)
            self._saved = f"{self._target}" + (f"; the one that was there is now {kept.name}" if kept else "")
        except DataError as error:
            self._note = str(error)

    async def converse(self, channel: WebSocket) -> None:
        """The shape, then the state after each word of the browser."""
        await channel.accept()
        try:
            await channel.send_text(to_json(self.shape() | self.state()))
            while True:
                self.command(await channel.receive_text())
                await channel.send_text(to_json(self.state()))
        except (ValueError, IndexError):
            await channel.close(1008)
        except (WebSocketDisconnect, RuntimeError):
            pass


async def serve(settings: dict[str, Any], send: Callable[..., None]) -> None:
    """Serve until standard input ends."""
    page = ElectrodePlacement(Skin.parse(settings["skin"]), Path(settings["target"]))
    await serve_page("electrodes.html", page.converse, _LARGEST_ANSWER, settings, send, when_input_ends)


if __name__ == "__main__":
    run(serve)
