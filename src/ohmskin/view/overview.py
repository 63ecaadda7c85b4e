"""The page that shows all patches of a robot at once: on the robot in space, and as small maps on a grid.

It reads the boards itself, so nothing waits for it.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket, WebSocketDisconnect

from ohmskin.child import when_input_ends
from ohmskin.client.board import BoardReader
from ohmskin.client.contacts import Contacts, PlacedContact, SharedMemory
from ohmskin.client.joints import LinkPoses
from ohmskin.closing import Closing
from ohmskin.errors import PublishError
from ohmskin.outlets.picture import Picture
from ohmskin.view.finger import Finger, Press
from ohmskin.view.live import check_address, start_page
from ohmskin.view.server import run, serve_page
from ohmskin.view.wire import pack_frame

_FRAMES_PER_SECOND, _FRAMES_IN_SPACE = 12, 50
_LARGEST_ANSWER = 96  # bytes; a browser only says that it has drawn, and where its reader presses
_AHEAD = 2  # frames that a browser may have got and not answered
_ROBOT = -1  # beside the numbers of patches: what a browser is told once


class Overview(Closing):
    """The page, served by a process of its own.

    Args:
        name: Board with the contacts of all patches.
        boards: The boards of the patches, in the same order.
        robot: What it looks like (`Robot.known`); without it, there are maps only.
        host, port, token: As for `LiveView`.

    Attributes:
        url: Where the page is.

    Raises:
        ViewError: If no port is free, or the host is not loopback and there is no token.
    """

    def __init__(
        self,
        name: str,
        boards: Sequence[str],
        host: str = "127.0.0.1",
        port: int = 8000,
        token: str | None = None,
        robot: Mapping[str, Any] | None = None,
    ) -> None:
        check_address(host, port, token)
        settings = {"name": name, "boards": list(boards), "robot": robot}
        self._child, _, self.url = start_page("ohmskin.view.overview", settings, host, port, token)

    def close(self) -> None:
        self._child.close()


class BoardsPage:
    """The newest of all boards, as browsers get it."""

    def __init__(self, name: str, boards: Sequence[str], robot: Mapping[str, Any] | None = None) -> None:
        self._name, self._names, self._robot = name, list(boards), robot
        self._every = 1 / (_FRAMES_PER_SECOND if robot is None else _FRAMES_IN_SPACE)
        self._merged, self._links = SharedMemory(name), LinkPoses(name)
        self._pictures = [BoardReader(f"{board}.image") for board in boards]
        self._devices = [BoardReader(f"{board}.device") for board in boards]
        self._addresses = [""] * len(self._names)  # of virtual skins
        self._images: list[tuple[dict[str, Any], NDArray]] = [({}, np.zeros(0))] * len(self._names)
        self._setups: list[tuple[int, dict[str, Any]]] = [(0, {})] * len(self._names)
        self._pictures_of: list[Picture | None] = [None] * len(self._names)
        self._newest: Contacts | None = None

    def frame(self, known: dict[int, int] | None = None, note: str = "") -> bytes:
        """Length of a JSON text, the text, and each patch's pixels as signed bytes (127ths of its `peak`).

        Args:
            known: Which shapes a browser knows already, which is kept there.
            note: What its reader should know.
        """
        patches, pixels, known = [], [], {} if known is None else known
        with contextlib.suppress(PublishError):  # a board of another version: shown as silent
            self._newest = self._merged.newest() or self._newest
        for number, name in enumerate(self._names):
            (about, image), title = self._image(number), name.rpartition(".")[2]
            shown: dict[str, Any] = {"name": title, "link": "", "age": None, "mode": "", "contacts": []}
            if self._newest is not None and number < len(self._merged.patches):
                patch, seen = self._merged.patches[number], self._newest.patches[number]
                shown |= {"name": patch.name, "link": patch.frame, "mode": seen.mode, "newtons": patch.newtons}
                shown["age"] = seen.age if seen.sequence else None
                own = [contact for contact in self._newest.contacts if contact.patch == patch.name]
                if (picture := self._pictures_of[number]) is not None:
                    shown["contacts"] = [_shown(one, *picture.place(one.position, about["raster"])) for one in own]
            if self._robot is not None:
                shown |= self._in_space(number, known)
            patches.append(shown | about)
            pixels.append(image)
        header: dict[str, Any] = {"name": self._name, "patches": patches, "note": note}
        if self._robot is not None:
            with contextlib.suppress(PublishError):
                header["links"] = self._links.newest()
            if _ROBOT not in known:
                known[_ROBOT], header["robot"] = 1, self._robot
        return pack_frame(header, *pixels, dtype="i1")

    def pressed(self, answer: str) -> Press | None:
        """Where a browser's reader presses: ``PATCH X Y Z``, a patch's number and a point in its frame (m).

        Raises:
            ValueError: If that is no such answer.
        """
        if answer == "drawn":
            return None
        which, *point = answer.split()
        number, place = int(which), [float(word) for word in point]
        if not 0 <= number < len(self._names) or len(place) != 3 or not all(abs(value) < 100 for value in place):
            raise ValueError(f"no place on a patch: {answer!r}")
        picture, address = self._pictures_of[number], self._addresses[number]
        return (address, picture.place(place, self._images[number][0]["raster"])) if picture and address else None

    def _in_space(self, number: int, known: dict[int, int]) -> dict[str, Any]:
        """Whether a patch can be pressed, and, once, where its pixels are in its frame (m); those off it are null."""
        with contextlib.suppress(PublishError):
            if (address := self._devices[number].newest()) is not None:
                self._addresses[number] = address.decode()
        shown: dict[str, Any] = {"virtual": bool(self._addresses[number]) and not self._devices[number].closed}
        boot, picture = self._setups[number][0], self._pictures_of[number]
        if picture is not None and self._newest is not None and known.get(number) != boot:  # which says on what link
            known[number] = boot
            away = np.isnan(picture.pixels).ravel()
            points = picture.points.reshape(-1, 3).round(5).tolist()
            shown["points"] = [None if off else point for off, point in zip(away, points, strict=True)]
        return shown

    def _image(self, number: int) -> tuple[dict[str, Any], NDArray]:
        """What is known of a patch's shape and image, and its pixels."""
        reader = self._pictures[number]
        with contextlib.suppress(PublishError):  # it does not fit its setup: the one before stays
            if (content := reader.newest()) is not None:
                if self._setups[number][0] != reader.boot:  # numbers are read from text once
                    points = np.asarray(reader.setup.get("points", []), float)
                    self._setups[number] = reader.boot, {**reader.setup, "points": points}
                setup = self._setups[number][1]
                self._pictures_of[number] = picture = Picture.unpack(content, setup)
                values = np.where(np.isfinite(picture.pixels), picture.pixels, 0.0)
                peak = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
                about = {"domain": setup["domain"], "raster": setup["raster"], "peak": peak, "size": values.size}
                values *= 127 / peak if peak else 0.0
                self._images[number] = about, np.rint(values, out=values)
        return self._images[number]

    async def converse(self, channel: WebSocket) -> None:
        """A frame for each word of the browser, and no sooner than is due: one that does not answer gets no more.

        The next frame is on its way while the browser answers the last one, so that their ways add up to no wait.
        """
        await channel.accept()
        known: dict[int, int] = {}
        finger, answered = Finger(), asyncio.Semaphore(_AHEAD)

        async def receive() -> None:
            try:
                while True:
                    finger.point(self.pressed(await channel.receive_text()))
                    answered.release()
            finally:
                answered.release()

        hearing = asyncio.create_task(receive())
        try:
            while True:
                began = time.monotonic()
                await answered.acquire()
                if hearing.done():
                    await hearing  # raises why
                await channel.send_bytes(self.frame(known, finger.note))
                await asyncio.sleep(max(0.0, began + self._every - time.monotonic()))
        except ValueError:
            await channel.close(1008)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            hearing.cancel()
            await finger.close()


def _shown(contact: PlacedContact, x: float, y: float) -> dict[str, Any]:
    """A contact on its skin's map and in its link's frame."""
    names = ("id", "extent", "strength", "confidence", "normal", "force", "force_std", "self_touch")
    return {**{name: getattr(contact, name) for name in names}, "x": x, "y": y, "in": contact.position}


async def serve(settings: dict[str, Any], send: Callable[..., None]) -> None:
    """Serve until standard input ends."""
    page = BoardsPage(settings["name"], settings["boards"], settings["robot"])
    await serve_page("overview.html", page.converse, _LARGEST_ANSWER, settings, send, when_input_ends)


if __name__ == "__main__":
    run(serve)
