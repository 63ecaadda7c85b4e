"""The conductive sheet of a skin: its shape, flat or in space, and how it conducts."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ohmskin.errors import GeometryError, SkinError
from ohmskin.geometry import Chart, Disc, FlatChart, Rectangle, RevolutionChart
from ohmskin.skin.checks import choice, number, places

_TURN = 2 * np.pi
_PROFILE = 60  # points of the profile of a cap


@dataclass(frozen=True)
class Sheet:
    """The conductive sheet.

    Flat: a ``rectangle`` has its lower left corner at the origin, a ``disc`` is centred there. In space, about the z
    axis: a ``cylinder`` of `radius` from z = 0 to `height`, and a ``cone`` from `radius` to `top_radius`, of which
    there is the part `angle` of a turn about the direction of x, or all of it, a sleeve; a ``sphere``, the cap of a
    ball of `radius` about the origin down to `angle` from the positive z axis; and ``revolution``, whatever `profile`
    [distance from the axis, z] says. Its map, on which electrodes are placed and contacts told, is `RevolutionChart`.
    """

    shape: str = choice("rectangle", "rectangle", "disc", "cylinder", "cone", "sphere", "revolution")
    width: float = number(0.2, 1e-3, 10, "m")
    height: float = number(0.2, 1e-3, 10, "m")
    radius: float = number(0.1, 1e-3, 10, "m")
    top_radius: float = number(0.05, 1e-3, 10, "m")
    angle: float = number(_TURN, 0.1, _TURN, "rad")
    profile: tuple[tuple[float, float], ...] = ()
    conductivity: float = number(1.83e-3, 1e-9, 1e6, "S per square")

    def __post_init__(self) -> None:
        object.__setattr__(self, "profile", places(self.profile))

    @property
    def chart(self) -> Chart:
        """The map of the sheet.

        Raises:
            SkinError: If there is no such sheet.
        """
        try:
            return _chart(self)
        except GeometryError as error:
            raise SkinError(f"sheet: {error}") from None


@lru_cache(maxsize=64)
def _chart(sheet: Sheet) -> Chart:
    if (sheet.shape == "revolution") != bool(sheet.profile):
        raise GeometryError('a profile and shape = "revolution" go together')
    if sheet.shape == "rectangle":
        return FlatChart(Rectangle(sheet.width, sheet.height))
    if sheet.shape == "disc":
        return FlatChart(Disc(sheet.radius))
    if sheet.shape == "revolution":
        return RevolutionChart(sheet.profile, sheet.angle)
    if sheet.shape == "sphere":
        if sheet.angle > 0.9 * np.pi:
            raise GeometryError(f"a cap reaches {sheet.angle:.3g} rad from its pole; it may reach 2.8 rad, see angle")
        polar = np.linspace(0, sheet.angle, _PROFILE)
        return RevolutionChart(sheet.radius * np.column_stack([np.sin(polar), np.cos(polar)]))
    top = sheet.radius if sheet.shape == "cylinder" else sheet.top_radius
    return RevolutionChart([(sheet.radius, 0.0), (top, sheet.height)], sheet.angle)
