"""A finger on a page that presses virtual skins: the newest place counts, and no page waits for a skin."""

import asyncio

from ohmskin.device import Device, connect
from ohmskin.errors import DeviceError

_RADIUS, _PRESSURE = 8e-3, 20e3  # m, Pa: a firm fingertip

Press = tuple[str, tuple[float, float]]
"""Address of a virtual skin, and the place on its map (m)."""


class Finger:
    """One reader's finger. It lifts by hanging up: a virtual skin forgets the presses of whoever has gone.

    Attributes:
        note: Why the last press failed; empty if it did not.
    """

    def __init__(self) -> None:
        self.note = ""
        self._wanted: Press | None = None
        self._done: Press | None = None
        self._device: Device | None = None
        self._task: asyncio.Task[None] | None = None

    def point(self, wanted: Press | None) -> None:
        """Press there and nowhere else, or nowhere; never waits."""
        self._wanted = wanted
        if wanted != self._done and (self._task is None or self._task.done()):
            self._task = asyncio.create_task(self._follow())

    async def close(self) -> None:
        """Lift."""
        self.point(None)
        if self._task is not None:
            await self._task

    async def _follow(self) -> None:
        while self._wanted != self._done:
            wanted, before, self._done = self._wanted, self._done, self._wanted
            try:
                await asyncio.to_thread(self._press, wanted, before)
                self.note = ""
            except DeviceError as error:
                self.note = str(error)

    def _press(self, wanted: Press | None, before: Press | None) -> None:
        if self._device is not None and (wanted is None or before is None or wanted[0] != before[0]):
            self._device.close()
            self._device = None
        if wanted is not None:
            self._device = self._device or connect(wanted[0])
            self._device.press(0, wanted[1], _RADIUS, _PRESSURE)
