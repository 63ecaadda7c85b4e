"""The publisher: a sink that shows other programs what one skin feels."""

import re
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.client.board import Board
from ohmskin.client.contacts import LARGEST, Contacts, Patch, PatchState, PlacedContact, merged, pack
from ohmskin.closing import Closing
from ohmskin.contacts import in_frame
from ohmskin.engine import Touch
from ohmskin.errors import DataError, PublishError
from ohmskin.geometry import Disc, Polygon, Raster
from ohmskin.geometry.holes import Holed, clipped, without_holes
from ohmskin.mcap.standard import encode_health
from ohmskin.outlets.picture import Picture
from ohmskin.outlets.relay import RelayProcess
from ohmskin.skin import Skin

_PIXELS = 64  # along the longer side, as on the live page
_HEALTH_EVERY, _LARGEST_HEALTH, _LONGEST_MESSAGE = 1.0, 2**14, 2000  # s, bytes, characters


class Publisher(Closing):
    """Shows what a skin feels in shared memory and, through a process of its own, to ROS 2 and others.

    Args:
        skin: The skin whose contacts they are.
        outlets: Where to publish beside shared memory; see `ohmskin.outlets.outlet.open_outlet`.
        name: What clients call it; topics begin with it, too.
        patch: Where the sheet sits on the robot; its own frame ``skin`` unless given.
        token: What listeners on other machines must give, where the protocol knows such a thing.
        images: Most images per second.

    Attributes:
        addresses: Where outlets are.

    Raises:
        PublishError: If the name is taken, or an outlet cannot be opened.
    """

    def __init__(
        self,
        skin: Skin,
        outlets: Sequence[str] = (),
        name: str = "skin",
        patch: Patch = Patch(),  # noqa: B008, a frozen value
        token: str | None = None,
        images: float = 30.0,
    ) -> None:
        check_settings(token, images)
        self.patch = patch = replace(patch, newtons=skin.tells_force)
        self.raster = Raster(skin.mesh(), _PIXELS)
        self._every, self._due, self._health_due = 1 / images, 0.0, 0.0
        self._chart, self._name, self._about = skin.chart, name, skin.name
        setup = {"skin": skin.name, "domain": describe_domain(skin), "patches": [asdict(patch)]}
        about = setup | Picture.setup(self.raster) | Picture.in_space(self.raster, self._chart, patch)
        size = Picture.size(self.raster)
        with ExitStack() as stack:
            self._board = stack.enter_context(Board(name, setup, LARGEST))
            self._picture = stack.enter_context(Board(f"{name}.image", about, size))
            self._health = stack.enter_context(Board(f"{name}.health", {}, _LARGEST_HEALTH))
            relay = RelayProcess(name, [f"{name}.image"], [patch], outlets, token, images)
            self._relay = stack.enter_context(relay)
            self._stack = stack.pop_all()
        self.addresses = [f"shm:{name}", *self._relay.addresses]

    def fit(self, skin: Skin) -> None:
        """Show images of the `skin` as it was fitted since, whose sheet is the same."""
        self.raster = Raster(skin.mesh(), _PIXELS)

    def publish(self, touch: Touch) -> None:
        """Publish the contacts of a cycle; never waits."""
        # The calendar may be set anew at any time, so that each stamp is taken from how long ago the sample was.
        stamp = time.time_ns() - round((time.monotonic() - touch.time) * 1e9)
        self._board.write(pack(self.contacts(touch, stamp), [self.patch]))
        if (now := time.monotonic()) >= self._due:
            self._due = now + self._every
            self.show(self.raster(touch.percept.image.values), touch.sequence, stamp)
        if now >= self._health_due:
            self._health_due = now + _HEALTH_EVERY
            message = "; ".join(finding.words for finding in touch.percept.findings)[:_LONGEST_MESSAGE]
            told = touch.health.diagnostics, message, self._about, stamp, f"ohmskin: {self._name}"
            self._health.write(encode_health(*told))
        self._relay.wake()

    def lost(self, why: str) -> None:
        """Tell once a second, as an error in the diagnostics, that there is nothing to publish; call it meanwhile.

        Args:
            why: What happened, such as that the device is lost.
        """
        if (now := time.monotonic()) >= self._health_due:
            self._health_due = now + _HEALTH_EVERY
            told = why[:_LONGEST_MESSAGE], self._about, time.time_ns(), f"ohmskin: {self._name}"
            self._health.write(encode_health({}, *told, error=True))
            self._relay.wake()

    def repeat(self, seen: PatchState, contacts: Sequence[PlacedContact]) -> None:
        """Publish contacts of before, `seen` then."""
        self._board.write(pack(merged(seen.sequence, [seen], contacts, self._board.boot), [self.patch]))

    def show(self, pixels: Floats, sequence: int, stamp: int) -> None:
        """Show an image (ny, nx); one of another size is none of this skin.

        Raises:
            DataError: If it is one.
        """
        if pixels.shape != self.raster.inside.shape:
            raise DataError(f"an image of {pixels.shape} pixels; this skin has {self.raster.inside.shape}")
        self._picture.write(Picture.pack(pixels, sequence, stamp))

    def contacts(self, touch: Touch, stamp: int) -> Contacts:
        """The contacts of a cycle, in the patch's frame."""
        told = touch.sequence, touch.time, stamp, touch.mode.name, touch.percept.total_force
        seen = PatchState(self.patch.name, self.patch.frame, *told)
        contacts = in_frame(touch.contacts, self._chart, self.patch)
        return merged(touch.sequence, [seen], contacts, self._board.boot)

    def close(self) -> None:
        """End outlets, take the boards away. Safe to call twice."""
        self._stack.close()


def check_settings(token: str | None, images: float) -> None:
    """Hold settings against their ranges.

    Raises:
        PublishError: If one is out of range.
    """
    if not 0 < images <= 1000:
        raise PublishError(f"images is {images} per second; it must be above 0 and at most 1000")
    if token is not None and not re.fullmatch(r"[A-Za-z0-9_-]{8,256}", token):
        raise PublishError("the token must be 8 to 256 letters, digits, '-' or '_', as secrets.token_urlsafe() gives")


def describe_domain(skin: Skin) -> dict[str, Any]:
    """The sheet's outline as boards and pages have it (m)."""
    domain, shape = skin.domain, without_holes(skin.domain)
    holes = [hole.vertices for hole in shape.holes] if isinstance(shape, Polygon) else []
    for hole in domain.cutouts if isinstance(domain, Holed) else ():
        corners, period = hole.polygon.vertices, domain.period  # round a band, in two parts where it lies on the seam
        turned = (corners + np.array([turn * period, 0.0]) for turn in range(-1, 2))
        parts = [clipped(part, 0.0, period) for part in turned] if period else [corners]
        holes += [part for part in parts if len(part) > 2]
    told = {"holes": [np.round(corners, 6).tolist() for corners in holes]}
    if isinstance(shape, Disc):
        return {"kind": "disc", "radius": shape.radius} | told
    if isinstance(shape, Polygon):
        return {"kind": "polygon", "outline": np.round(shape.vertices, 6).tolist()} | told
    x0, y0, x1, y1 = domain.bounds
    return {"kind": "band" if domain.period else "rectangle", "width": x1 - x0, "height": y1 - y0} | told
