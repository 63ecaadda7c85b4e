"""What is felt: contacts in the robot's frames, and their record on a board (docs/guide/publishing.md, for other languages)."""

import struct
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from ohmskin.errors import PublishError

MOST_CONTACTS, MOST_PATCHES = 256, 64

_HEAD = struct.Struct("<QdqII")
_PATCH = struct.Struct("<Qdq16s")
_CONTACT = struct.Struct("<iI11d")
LARGEST = _HEAD.size + MOST_PATCHES * _PATCH.size + MOST_CONTACTS * _CONTACT.size
"""Bytes of the largest record."""


@dataclass(frozen=True)
class Patch:
    """One skin and where it sits.

    Args:
        name: What it is called.
        frame: The frame of its contacts: a link of the robot, or ``skin`` for the sheet itself.
        position: Origin of the sheet in that frame (m).
        axes: Directions of the sheet's x, y and outward normal in that frame, one after the other.
    """

    name: str = "skin"
    frame: str = "skin"
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def place(self, x: float, y: float) -> tuple[float, float, float]:
        """A place on the sheet (m) in the frame."""
        (ax, ay, az), (bx, by, bz), _ = self.axes
        px, py, pz = self.position
        return (px + x * ax + y * bx, py + x * ay + y * by, pz + x * az + y * bz)

    def flat(self, place: Sequence[float]) -> tuple[float, float]:
        """Where on the sheet a place in the frame is; the inverse of `place`."""
        offset = [p - q for p, q in zip(place, self.position, strict=True)]
        x, y = (sum(o * a for o, a in zip(offset, axis, strict=True)) for axis in self.axes[:2])
        return x, y

    @property
    def normal(self) -> tuple[float, float, float]:
        """The outward normal in the frame."""
        return self.axes[2]


@dataclass(frozen=True)
class Contact:
    """One place where the robot is touched.

    Args:
        id: Stays while the contact lasts; counted by each patch for itself.
        patch: Name of the patch.
        frame: Frame of position and normal.
        position: Where (m).
        normal: Outward normal of the skin there.
        extent: Area above half the peak (m2).
        strength: Integral of the relative conductivity change over the extent (m2); not a force, but grows with it.
        confidence: Probability that it is one (0 to 1).
        peak: Largest relative conductivity change.
        spread: Standard deviation of the position in its worst direction (m); NaN where the mode does not tell.
    """

    id: int
    patch: str
    frame: str
    position: tuple[float, float, float]
    normal: tuple[float, float, float]
    extent: float
    strength: float
    confidence: float
    peak: float
    spread: float = float("nan")


@dataclass(frozen=True)
class Sighting:
    """How fresh a patch's part is.

    Args:
        patch: Name of the patch.
        frame: Its frame.
        sequence: Number of its newest cycle; 0 if it has not been heard of.
        time: Its last sample on this machine's monotonic clock (s); minus infinity if it has not been heard of.
        stamp: The same by the calendar (ns since 1970); 0 likewise.
        mode: Its drive mode.
    """

    patch: str
    frame: str
    sequence: int = 0
    time: float = -inf
    stamp: int = 0
    mode: str = ""

    @property
    def age(self) -> float:
        """Seconds since its last sample, now."""
        return time.monotonic() - self.time


@dataclass(frozen=True)
class Felt:
    """What the skin, or all skins of a robot, felt last.

    Args:
        sequence: Counts up by one with each; a jump tells of ones that were not looked at. Begins anew with `boot`.
        time: The last sample of the patch heard of longest ago, on this machine's monotonic clock (s).
        stamp: The same by the calendar (ns since 1970).
        patches: How fresh each patch is.
        contacts: All contacts, those of a patch strongest first.
        boot: Changes whenever the sender starts anew.
    """

    sequence: int
    time: float
    stamp: int
    patches: tuple[Sighting, ...]
    contacts: tuple[Contact, ...]
    boot: int = 0

    @property
    def age(self) -> float:
        """Seconds since the last sample of the patch heard of longest ago, now: a silent patch makes all of it old."""
        return time.monotonic() - self.time


def felt(sequence: int, patches: Sequence[Sighting], contacts: Sequence[Contact], boot: int = 0) -> Felt:
    """What patches felt together, as old as the oldest of them."""
    oldest = min(patches, key=lambda sighting: sighting.time)
    return Felt(sequence, oldest.time, oldest.stamp, tuple(patches), tuple(contacts), boot)


def pack(felt: Felt, patches: Sequence[Patch]) -> bytes:
    """The record of `felt` on a board whose setup tells of `patches`; the strongest `MOST_CONTACTS` contacts of it."""
    numbers = {patch.name: number for number, patch in enumerate(patches)}
    contacts = felt.contacts
    if len(contacts) > MOST_CONTACTS:
        contacts = tuple(sorted(contacts, key=lambda contact: -abs(contact.peak))[:MOST_CONTACTS])
    parts = [_HEAD.pack(felt.sequence, felt.time, felt.stamp, len(felt.patches), len(contacts))]
    parts += [_PATCH.pack(s.sequence, s.time, s.stamp, s.mode.encode()[:16]) for s in felt.patches]
    for c in contacts:
        figures = (c.extent, c.strength, c.confidence, c.peak, c.spread)
        parts.append(_CONTACT.pack(c.id, numbers[c.patch], *c.position, *c.normal, *figures))
    return b"".join(parts)


def unpack(record: bytes, patches: Sequence[Patch], boot: int = 0) -> Felt:
    """What a record says; the inverse of `pack`.

    Raises:
        PublishError: If it is not such a record.
    """
    try:
        sequence, at, stamp, n_patches, n_contacts = _HEAD.unpack_from(record)
        if n_patches != len(patches) or len(record) != _HEAD.size + n_patches * _PATCH.size + n_contacts * _CONTACT.size:
            raise PublishError(f"a record of {len(record)} bytes says {n_patches} patches and {n_contacts} contacts")
        middle = _HEAD.size + n_patches * _PATCH.size
        sightings = [
            Sighting(patch.name, patch.frame, number, seen, when, mode.rstrip(b"\0").decode(errors="replace"))
            for patch, (number, seen, when, mode) in zip(patches, _PATCH.iter_unpack(record[_HEAD.size : middle]), strict=True)
        ]
        contacts = []
        for number, which, x, y, z, nx, ny, nz, *figures in _CONTACT.iter_unpack(record[middle:]):
            patch = patches[which]
            contacts.append(Contact(number, patch.name, patch.frame, (x, y, z), (nx, ny, nz), *figures))
    except (struct.error, IndexError) as error:
        raise PublishError(f"a record of {len(record)} bytes cannot be read: {error}") from error
    return Felt(sequence, at, stamp, tuple(sightings), tuple(contacts), boot)


def patches_from(setup: Mapping[str, Any]) -> tuple[Patch, ...]:
    """The patches that the setup of a board tells of.

    Raises:
        PublishError: If it tells of none.
    """
    try:
        return tuple(
            Patch(str(p["name"]), str(p["frame"]), tuple(p["position"]), tuple(tuple(axis) for axis in p["axes"]))
            for p in setup["patches"]
        )
    except (KeyError, TypeError) as error:
        raise PublishError(
            f"the setup of a board does not tell its patches ({error!r}); is its writer of another version?"
        ) from error
