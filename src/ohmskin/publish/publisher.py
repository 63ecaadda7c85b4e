"""The publisher: a sink that shows other programs what one skin feels."""

import time
from collections.abc import Sequence
from dataclasses import asdict
from math import nan
from typing import Any, Self

import numpy as np

from ohmskin.client.board import Board
from ohmskin.client.felt import LARGEST, Contact, Felt, Patch, Sighting, felt, pack
from ohmskin.engine import Touch
from ohmskin.errors import PublishError
from ohmskin.geometry import Disc, Raster
from ohmskin.publish.picture import Picture
from ohmskin.publish.relay import RelayProcess
from ohmskin.skin import Skin
from ohmskin.touch import Contact as FlatContact

_PIXELS = 64  # along the longer side, as on the live page


class Publisher:
    """Shows what a skin feels to programs on this machine (shared memory) and, through a process of its own, to ROS 2 and others.

    Args:
        skin: What is felt with.
        outlets: Where to publish beside shared memory; see `ohmskin.publish.outlet.open_outlet`.
        name: What clients call it; topics begin with it, too.
        patch: Where the sheet sits on the robot; its own frame ``skin`` unless given.
        scale: Newtons per m2 of contact strength, if somebody has calibrated that; wrenches are published with it only.
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
        scale: float | None = None,
        token: str | None = None,
        images: float = 30.0,
    ) -> None:
        check_settings(scale, token, images)
        self.patch = patch
        self._raster = Raster(skin.mesh(), _PIXELS)
        self._every, self._due = 1 / images, 0.0
        setup = {"skin": skin.name, "domain": _domain(skin), "patches": [asdict(patch)]}
        self._board = Board(name, setup, LARGEST)
        self._picture: Board | None = None
        self._relay: RelayProcess | None = None
        try:
            self._picture = Board(f"{name}.image", setup | Picture.setup(self._raster), Picture.size(self._raster))
            self._relay = RelayProcess(name, [f"{name}.image"], scale, outlets, token, images)
        except BaseException:
            self.close()
            raise
        self.addresses = [f"shm:{name}", *self._relay.addresses]

    def publish(self, touch: Touch) -> None:
        """Show what a cycle felt; never waits."""
        # The calendar may be set anew at any time, so that each stamp is taken from how long ago the sample was.
        stamp = time.time_ns() - round((time.monotonic() - touch.time) * 1e9)
        self._board.write(pack(self.felt(touch, stamp), [self.patch]))
        if self._picture is not None and (now := time.monotonic()) >= self._due:
            self._due = now + self._every
            self._picture.write(Picture.pack(self._raster(touch.sight.image.values), touch.sequence, stamp))
        if self._relay is not None:
            self._relay.wake()

    def felt(self, touch: Touch, stamp: int) -> Felt:
        """What a cycle felt, in the patch's frame."""
        seen = Sighting(self.patch.name, self.patch.frame, touch.sequence, touch.time, stamp, touch.mode.name)
        return felt(touch.sequence, [seen], [_placed(contact, self.patch) for contact in touch.contacts], self._board.boot)

    def close(self) -> None:
        """End outlets, take the boards away. Safe twice."""
        if self._relay is not None:
            self._relay.close()
        if self._picture is not None:
            self._picture.close()
        self._board.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_settings(scale: float | None, token: str | None, images: float) -> None:
    """Hold settings against their ranges.

    Raises:
        PublishError: If one is out of range.
    """
    if scale is not None and not 0 < scale < 1e12:
        raise PublishError(f"{scale} newtons per m2 of strength; it must be positive")
    if not 0 < images <= 1000:
        raise PublishError(f"images is {images} per second; it must be above 0 and at most 1000")
    if token is not None and not (8 <= len(token) <= 256 and token.isascii() and token.replace("-", "").replace("_", "").isalnum()):
        raise PublishError("the token must be 8 to 256 letters, digits, '-' or '_', such as secrets.token_urlsafe() gives")


def _placed(contact: FlatContact, patch: Patch) -> Contact:
    figures = (float(contact.extent), float(contact.strength), float(contact.confidence), float(contact.peak))
    spread = nan if contact.covariance is None else _worst(contact.covariance)
    place = patch.place(*contact.position)
    return Contact(contact.id, patch.name, patch.frame, place, patch.normal, *figures, spread)


def _worst(covariance: tuple[tuple[float, float], tuple[float, float]]) -> float:
    """Standard deviation in the worst direction (m)."""
    (xx, xy), (_, yy) = covariance
    return float(np.sqrt((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)))


def _domain(skin: Skin) -> dict[str, Any]:
    if isinstance(skin.domain, Disc):
        return {"kind": "disc", "radius": skin.sheet.radius}
    return {"kind": "rectangle", "width": skin.sheet.width, "height": skin.sheet.height}
