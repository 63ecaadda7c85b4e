"""Contacts in the robot's frames, and their record in shared memory (docs/guide/publishing.md)."""

import struct
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, nan, sqrt
from typing import Any

from ohmskin.client.board import BoardReader
from ohmskin.client.fields import as_number, attributes, components, known, numbers
from ohmskin.errors import PublishError

MOST_CONTACTS, MOST_PATCHES = 256, 64
_NAP = 0.0003  # seconds between looks while waiting; a look costs some microseconds

_HEAD = struct.Struct("<QdqII")
_PATCH = struct.Struct("<Qdq16sd")
_COMPONENTS = components(3)
_CONTACT = struct.Struct(f"<Ii{len(_COMPONENTS) - 1}d")
LARGEST = _HEAD.size + MOST_PATCHES * _PATCH.size + MOST_CONTACTS * _CONTACT.size
"""Bytes of the largest record."""


@dataclass(frozen=True)
class Patch:
    """One skin and its pose in a frame.

    Args:
        name: Its name.
        frame: The frame of its contacts: a link of the robot, or ``skin`` for the sheet itself.
        position: Origin of the sheet, or of the frame that a curved skin is described in, in that frame (m).
        axes: Directions of its x, y and z in that frame, one after the other; z is the outward normal of a flat sheet.
        newtons: Whether its contacts have a force: only if the skin was calibrated for that.
    """

    name: str = "skin"
    frame: str = "skin"
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    newtons: bool = False

    def place(self, x: float, y: float, z: float = 0.0) -> tuple[float, float, float]:
        """The point (`x`, `y`, `z`) of the sheet (m), in the frame (m)."""
        (px, py, pz), (tx, ty, tz) = self.position, self.turn(x, y, z)
        return px + tx, py + ty, pz + tz

    def turn(self, x: float, y: float, z: float = 0.0) -> tuple[float, float, float]:
        """The vector (`x`, `y`, `z`) of the sheet, in the frame: turned, in the same unit."""
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = self.axes
        return x * ax + y * bx + z * cx, x * ay + y * by + z * cy, x * az + y * bz + z * cz

    def at(self, point: Sequence[float], axes: Sequence[Sequence[float]]) -> "Patch":
        """The flat sheet that touches a curved one at a point.

        Args:
            point: (3,) as in `place` (m).
            axes: (3, 3) directions of its x, y and normal there.
        """
        x, y, normal = (self.turn(*axis) for axis in axes)
        return replace(self, position=self.place(*point), axes=(x, y, normal))

    def contact(self, contact: Any) -> "PlacedContact":
        """A contact on the sheet (`ohmskin.contacts.PlacedContact`) in the frame."""
        velocity, flat = contact.velocity, contact.covariance
        covariance = None
        if flat is not None:
            (xx, xy), (_, yy) = flat
            u, v, _ = self.axes
            covariance = tuple(
                tuple(xx * (u[i] * u[j]) + yy * (v[i] * v[j]) + xy * (u[i] * v[j] + u[j] * v[i]) for j in range(3))
                for i in range(3)
            )
        return PlacedContact(
            id=contact.id,
            patch=self.name,
            frame=self.frame,
            position=self.place(*contact.position),
            normal=self.normal,
            extent=float(contact.extent),
            strength=float(contact.strength),
            confidence=float(contact.confidence),
            peak=float(contact.peak),
            radius=contact.radius,
            velocity=None if velocity is None else self.turn(*velocity),
            covariance=covariance,
            force=contact.force,
            force_std=contact.force_std,
            pressure=contact.pressure,
            area=contact.area,
        )

    @property
    def normal(self) -> tuple[float, float, float]:
        """The outward normal in the frame."""
        return self.axes[2]


@dataclass(frozen=True)
class PlacedContact:
    """One place where the robot is touched.

    Args:
        id: Unchanged while the contact lasts; each patch counts separately.
        patch: Name of the patch.
        frame: Frame of position and normal.
        position: Where (m).
        normal: Outward normal of the skin there.
        extent: Area above half the peak (m2).
        strength: Integral of the relative conductivity change over the extent (m2); not a force, but grows with it.
        confidence: Probability that the peak exceeds the detection threshold, given the noise (0 to 1).
        peak: Largest relative conductivity change.
        radius: Of the disc that explains the data best (m); None where the mode does not fit it.
        velocity: In the frame (m/s); None likewise.
        covariance: Of the position (3, 3) in the frame (m2); None likewise.
        force: Along the inward normal (N); None where the skin is not calibrated for force, or the force is not known
            yet.
        force_std: Standard deviation of the force (N); None likewise.
        pressure: The greatest (Pa); None likewise, or where the calibration lacks it.
        area: Force over pressure (m2); None likewise.
        self_touch: Whether another link of the robot touches here; None if that is not known.
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
    radius: float | None = None
    velocity: tuple[float, float, float] | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None
    force: float | None = None
    force_std: float | None = None
    pressure: float | None = None
    area: float | None = None
    self_touch: bool | None = None

    @property
    def spread(self) -> float:
        """Standard deviation of the position in its worst direction on the skin (m); NaN if it is not known."""
        if self.covariance is None:
            return nan
        # two eigenvalues are not zero: their sum is the trace, the sum of their squares that of all entries
        trace = sum(self.covariance[i][i] for i in range(3))
        squares = sum(entry * entry for row in self.covariance for entry in row)
        return sqrt(trace / 2 + sqrt(max(0.0, 2 * squares - trace * trace)) / 2)

    def moved(self, pose: Sequence[Sequence[float]], frame: str) -> "PlacedContact":
        """The same contact in another frame.

        Args:
            pose: Pose of its own frame in the other: rows of a matrix (4, 4) (m).
            frame: Name of the other.
        """

        def turn(vector: Sequence[float]) -> tuple[float, ...]:
            return tuple(sum(pose[i][j] * vector[j] for j in range(3)) for i in range(3))

        covariance = self.covariance
        if covariance is not None:
            covariance = tuple(map(turn, zip(*map(turn, covariance), strict=True)))
        position = tuple(turned + pose[i][3] for i, turned in enumerate(turn(self.position)))
        velocity = None if self.velocity is None else turn(self.velocity)
        changed = {"position": position, "normal": turn(self.normal), "velocity": velocity, "covariance": covariance}
        return replace(self, frame=frame, **changed)  # type: ignore[arg-type]


@dataclass(frozen=True)
class PatchState:
    """Sequence number and time of a patch's newest data.

    Args:
        patch: Name of the patch.
        frame: Its frame.
        sequence: Number of its newest cycle; 0 before the first.
        time: Its last sample on this machine's monotonic clock (s); minus infinity before the first.
        stamp: The same by the calendar (ns since 1970); 0 likewise.
        mode: Name of its mode.
        total_force: Of all contacts on it, as its auxiliary channel measures it (N); None without a sound one.
    """

    patch: str
    frame: str
    sequence: int = 0
    time: float = -inf
    stamp: int = 0
    mode: str = ""
    total_force: float | None = None

    @property
    def age(self) -> float:
        """Seconds since its last sample, now."""
        return time.monotonic() - self.time


@dataclass(frozen=True)
class Contacts:
    """The newest contacts of a skin, or of all skins of a robot.

    Args:
        sequence: Increases by one with each message; a jump means that some were not read. Restarts with `boot`.
        time: Last sample of the patch with the oldest data, on this machine's monotonic clock (s).
        stamp: The same by the calendar (ns since 1970).
        patches: Sequence number and time of each patch.
        contacts: All contacts, those of a patch strongest first.
        boot: Changes whenever the sender restarts.
    """

    sequence: int
    time: float
    stamp: int
    patches: tuple[PatchState, ...]
    contacts: tuple[PlacedContact, ...]
    boot: int = 0

    @property
    def age(self) -> float:
        """Present age (s) of the oldest patch's last sample: one silent patch makes all contacts old."""
        return time.monotonic() - self.time


def merged(sequence: int, patches: Sequence[PatchState], contacts: Sequence[PlacedContact], boot: int = 0) -> Contacts:
    """The contacts of all patches together, as old as the oldest of them."""
    oldest = min(patches, key=lambda state: state.time)
    return Contacts(sequence, oldest.time, oldest.stamp, tuple(patches), tuple(contacts), boot)


def wrench(contacts: Sequence[PlacedContact]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The force (N) that contacts push a link with, and its torque about the origin of their frame (N m).

    Args:
        contacts: All in one frame; one whose force is not known counts for nothing.
    """
    force, torque = [0.0] * 3, [0.0] * 3
    for contact in contacts:
        push = [-(contact.force or 0.0) * along for along in contact.normal]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            force[i] += push[i]
            torque[i] += contact.position[j] * push[k] - contact.position[k] * push[j]
    return tuple(value + 0.0 for value in force), tuple(value + 0.0 for value in torque)  # no minus zeros


def pack(given: Contacts, patches: Sequence[Patch]) -> bytes:
    """The record of `given` on a board whose setup has `patches`; the strongest `MOST_CONTACTS` contacts of it."""
    places = {patch.name: number for number, patch in enumerate(patches)}
    contacts = given.contacts
    if len(contacts) > MOST_CONTACTS:
        contacts = tuple(sorted(contacts, key=lambda contact: -abs(contact.peak))[:MOST_CONTACTS])
    parts = [_HEAD.pack(given.sequence, given.time, given.stamp, len(given.patches), len(contacts))]
    parts += [
        _PATCH.pack(s.sequence, s.time, s.stamp, s.mode.encode()[:16], as_number(s.total_force)) for s in given.patches
    ]
    parts += [_CONTACT.pack(places[c.patch], *numbers(c, 3)) for c in contacts]
    return b"".join(parts)


def unpack(record: bytes, patches: Sequence[Patch], boot: int = 0) -> Contacts:
    """What a record says; the inverse of `pack`.

    Raises:
        PublishError: If it is not such a record.
    """
    try:
        sequence, at, stamp, n_patches, n_contacts = _HEAD.unpack_from(record)
        middle = _HEAD.size + n_patches * _PATCH.size
        if n_patches != len(patches) or len(record) != middle + n_contacts * _CONTACT.size:
            raise PublishError(f"a record of {len(record)} bytes claims {n_patches} patches and {n_contacts} contacts")
        rows = zip(patches, _PATCH.iter_unpack(record[_HEAD.size : middle]), strict=True)
        states = [
            PatchState(
                patch.name, patch.frame, count, seen, when, mode.rstrip(b"\0").decode(errors="replace"), known(total)
            )
            for patch, (count, seen, when, mode, total) in rows
        ]
        contacts = tuple(contact_from(patches[which], own) for which, *own in _CONTACT.iter_unpack(record[middle:]))
    except (struct.error, IndexError) as error:
        raise PublishError(f"a record of {len(record)} bytes cannot be read: {error}") from error
    return Contacts(sequence, at, stamp, tuple(states), contacts, boot)


def contact_from(patch: Patch, own: Sequence[float]) -> PlacedContact:
    """A contact of a patch, from its numbers in the order of `fields.components(3)`."""
    return PlacedContact(patch=patch.name, frame=patch.frame, **attributes(dict(zip(_COMPONENTS, own, strict=True)), 3))


def patches_from(setup: Mapping[str, Any]) -> tuple[Patch, ...]:
    """The patches in the setup of a board.

    Raises:
        PublishError: If it has none.
    """
    try:
        return tuple(
            Patch(
                *(str(p["name"]), str(p["frame"]), tuple(p["position"]), tuple(tuple(axis) for axis in p["axes"])),
                bool(p.get("newtons", False)),
            )
            for p in setup["patches"]
        )
    except (KeyError, TypeError) as error:
        what = f"the setup in shared memory lacks its patches ({error!r})"
        raise PublishError(f"{what}; is its writer of another version?") from error


class SharedMemory:
    """Contacts from the board of that name.

    Attributes:
        patches: The patches of the board; empty before there is one.
    """

    def __init__(self, name: str) -> None:
        self._board = BoardReader(name)
        self._boot = 0
        self.patches: tuple[Patch, ...] = ()

    def newest(self) -> Contacts | None:
        """The newest that was not given before; None if there is none. Never waits.

        Raises:
            PublishError: If the board is of another version.
        """
        if (record := self._board.newest()) is None:
            return None
        if self._board.boot != self._boot:
            self._boot, self.patches = self._board.boot, patches_from(self._board.setup)
        return unpack(record, self.patches, self._boot)

    def wait(self, timeout: float) -> Contacts | None:
        """The next that was not given before; None if nothing comes within `timeout` seconds."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            time.sleep(_NAP)
            if (fresh := self.newest()) is not None:
                return fresh
        return None

    def close(self) -> None:
        """Close the board. Safe to call twice."""
        self._board.close()
