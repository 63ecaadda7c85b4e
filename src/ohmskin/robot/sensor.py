"""A skin on a geom of any MuJoCo model: frames, images and contacts that a real one would give, in this process."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.client.contacts import Patch
from ohmskin.closing import Closing
from ohmskin.device.driver import Device
from ohmskin.device.virtual import twin_capabilities
from ohmskin.engine import Engine, Touch
from ohmskin.errors import ModelError
from ohmskin.geometry import FlatChart
from ohmskin.robot.batch import BatchSkin
from ohmskin.robot.display import mujoco
from ohmskin.robot.simulation import OFF, Push
from ohmskin.scan import DrivePattern, Frame
from ohmskin.sensing import default_mode, drive_of, modes
from ohmskin.skin import Fault, Press, Skin

_EDGE = 5e-3  # m, radius that a geom without one of its own, such as a box, is taken to touch with
_SAMPLES = 9  # along each side of a map, of points that must lie on the geom
_PLANE, _SPHERE, _CAPSULE, _CYLINDER, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("PLANE", "SPHERE", "CAPSULE", "CYLINDER", "BOX")
)


class SkinSensor(Closing):
    """A skin on a geom. Call it after `mj_step`, or let it scan many moments at once.

    Args:
        model: MuJoCo's model.
        geom: Name of the geom that wears it; anything that touches this geom on the skin presses the skin.
        skin: What it is, or its name.
        patch: Where the sheet sits in the geom's frame. Unless given: a flat one on the middle of the upper side (z) of
            a box or on a plane, a curved one round the middle of a cylinder or capsule.
        mode: Name of the mode; the default mode unless given.
        seed: Seed of the noise.
        faults: What is wrong with its wiring.

    Attributes:
        pattern: What `voltages` drives: the first scan of the mode.
        quiet: (n_meas,) voltages of the untouched skin (V), the mean of 32 frames.
        period: How long a frame of the loop takes the instrument (s); call the sensor as often in simulated time.

    Raises:
        ModelError: If there is no such geom, or the skin does not lie on it.
    """

    def __init__(
        self,
        model: Any,
        geom: str,
        skin: Skin | str = "paper",
        patch: Patch | None = None,
        mode: str = "",
        seed: int | None = None,
        faults: Sequence[Fault] = (),
    ) -> None:
        self.skin = skin = Skin.load(skin) if isinstance(skin, str) else skin
        try:
            self._geom = int(model.geom(geom).id)
        except KeyError:
            names = ", ".join(repr(model.geom(k).name) for k in range(model.ngeom))
            raise ModelError(f"the model has no geom {geom!r}; it has {names}") from None
        self.model, self.patch = model, patch or _usual(model, self._geom, skin)
        self._check_fit()
        known = modes(skin)
        if (mode := mode or default_mode(skin)) not in known:
            raise ModelError(f"skin {skin.name!r} has no mode {mode!r}; choose from {', '.join(known)}")
        self._mode, drive = mode, drive_of(known[mode], skin)
        self.pattern: DrivePattern = drive.next((), 0)
        self.period = sum(skin.cost.time(pattern) for pattern in drive.patterns[: drive.scans])
        self._seed, self._device = seed, _InProcess(BatchSkin(skin, seed, faults))
        self._engine: Engine | None = None
        self.quiet: Floats = self.voltages([()] * 32).mean(axis=0)

    def __call__(self, data: Any) -> Touch:
        """What the skin feels now: one frame of the real loop, with its contacts (on the sheet), image and findings.

        The first call calibrates the loop on the untouched skin, which takes some seconds. It does so with noise of its
        own, so that what is felt after a `reset` is the same before and after.
        """
        if self._engine is None:
            self._engine = self._calibrated()
        self._device.presses = self.presses(data)
        touch = self._engine.step()
        assert touch is not None  # this device is never lost
        return touch

    def voltages(self, cases: Sequence[Sequence[Press]]) -> Floats:
        """(n, n_meas) voltages (V) of n moments, one after the other, as the instrument reads them; no contacts.

        Args:
            cases: What presses in each; see `presses`.
        """
        frames = self._device.virtual.scans(cases, self.pattern)
        return np.array([frame.voltages for frame in frames]).reshape(-1, self.pattern.n_meas)

    def presses(self, data: Any) -> tuple[Press, ...]:
        """What presses the skin now, on its map: every MuJoCo contact of the geom that lies on the skin."""
        foam = self.skin.contact_layer.foam_spread
        return tuple(push.press(foam) for push in self.pushes(data))

    def pushes(self, data: Any) -> tuple[Push, ...]:
        """The same as MuJoCo has it: the truth."""
        found, wrench = list[Push](), np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            if self._geom not in (contact.geom1, contact.geom2):
                continue
            mujoco.mj_contactForce(self.model, data, number, wrench)
            turn = data.geom_xmat[self._geom].reshape(3, 3)
            local = (contact.pos - data.geom_xpos[self._geom]) @ turn - self.patch.position
            places, away = self.skin.chart.project(np.array(self.patch.axes) @ local)
            if wrench[0] <= 0 or away[0] > OFF or self.skin.domain.depth(places)[0] < 0:
                continue
            other = int(contact.geom2 if contact.geom1 == self._geom else contact.geom1)
            curved = (
                float(self.model.geom_size[other][0])
                if self.model.geom_type[other] in (_SPHERE, _CAPSULE, _CYLINDER)
                else _EDGE
            )
            radius = float(np.sqrt(2 * curved * max(0.0, -float(contact.dist))))
            name = self.model.body(self.model.geom_bodyid[other]).name
            found.append(Push(0, places[0], contact.pos.copy(), float(wrench[0]), radius, name))
        return tuple(found)

    def reset(self, seed: int | None = None) -> None:
        """Forget contacts that were followed, and begin the noise anew from a seed; what was calibrated stays."""
        self._device.virtual.reset(seed)
        if self._engine is not None:
            self._engine.forget()

    def close(self) -> None:
        """End the loop. Safe to call twice."""
        if self._engine is not None:
            self._engine.close()

    def _calibrated(self) -> Engine:
        """The loop, calibrated on a copy of the untouched skin: clock and noise of the skin itself do not move."""
        felt, self._device.presses = self._device.virtual, ()
        self._device.virtual = copy(felt)
        self._device.virtual.reset(self._seed)
        try:
            engine = Engine(lambda: self._device, self.skin, self._mode)
            engine.calibrate()
        finally:
            self._device.virtual = felt
        engine.forget()
        return engine

    def _check_fit(self) -> None:
        x0, y0, x1, y1 = self.skin.domain.bounds
        grid = np.stack(np.meshgrid(np.linspace(x0, x1, _SAMPLES), np.linspace(y0, y1, _SAMPLES)), axis=-1)
        places = grid.reshape(-1, 2)[self.skin.domain.depth(grid.reshape(-1, 2)) >= 0]
        points = np.array(self.patch.position) + self.skin.chart.points(places) @ np.array(self.patch.axes)
        kind, (a, b, c) = self.model.geom_type[self._geom], self.model.geom_size[self._geom]
        if kind == _BOX:
            outside = np.abs(points) - (a, b, c)
            off = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
        elif kind == _PLANE:
            off = points[:, 2]
        elif kind in (_CYLINDER, _CAPSULE):
            beyond = np.maximum(np.abs(points[:, 2]) - b, 0.0)
            off = np.hypot(np.hypot(points[:, 0], points[:, 1]), beyond) - a
        else:
            return  # of spheres and meshes the patch is taken as it is given
        if np.abs(off).max() > OFF:
            name = self.model.geom(self._geom).name
            told = (
                f"skin {self.skin.name!r} does not lie on geom {name!r}: it is off by {1e3 * np.abs(off).max():.0f} mm"
            )
            raise ModelError(f"{told}, allowed are {1e3 * OFF:.0f}; change the size of one, or give `patch`")


class _InProcess(Device):
    """The device of a skin in this process."""

    def __init__(self, virtual: BatchSkin) -> None:
        super().__init__("in-process:", replace(twin_capabilities(virtual.skin, "simulated", 0.0), settle_time=0.0))
        self.virtual, self.presses = virtual, tuple[Press, ...]()

    def _scan(self, pattern: DrivePattern, timeout: float) -> Frame:
        return self.virtual.scans([self.presses], pattern)[0]

    def _close(self) -> None:
        pass


def _usual(model: Any, geom: int, skin: Skin) -> Patch:
    kind, name = model.geom_type[geom], model.geom(geom).name
    x0, y0, x1, y1 = skin.domain.bounds
    middle = skin.chart.points([((x0 + x1) / 2, (y0 + y1) / 2)])[0]
    if isinstance(skin.chart, FlatChart) and kind in (_BOX, _PLANE):
        height = float(model.geom_size[geom][2]) if kind == _BOX else 0.0
        return Patch(skin.name, name, (-float(middle[0]), -float(middle[1]), height))
    if not isinstance(skin.chart, FlatChart) and kind in (_CYLINDER, _CAPSULE):
        return Patch(skin.name, name, (0.0, 0.0, -float(middle[2])))
    raise ModelError(f"where skin {skin.name!r} sits on geom {name!r} is not clear; give `patch`, in the geom's frame")
