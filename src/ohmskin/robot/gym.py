"""What a skin feels as a part of what a Gymnasium environment observes."""

from typing import Any, SupportsFloat

import numpy as np

from ohmskin.client.points import points
from ohmskin.errors import ModelError
from ohmskin.geometry import Raster
from ohmskin.robot.sensor import SkinSensor

try:
    import gymnasium
except ImportError as error:
    raise ModelError("environments need Gymnasium; install it: pip install 'ohmskin[gym]'") from error

_MOST = 4  # contacts
_PIXELS = 32  # along the longer side
KINDS = ("voltages", "image", "contacts")


class SkinObservation(gymnasium.Wrapper):  # type: ignore[misc]
    """Observes a MuJoCo environment and what a skin in it feels: a `Dict` with ``observation`` and ``skin``.

    Args:
        env: Its unwrapped environment has MuJoCo's `data`, as Gymnasium's own have.
        sensor: The skin.
        kind: ``voltages``: changes against the untouched skin (n_meas,) (V), the quickest; ``image``: relative
            conductivity change (ny, nx), bottom row first, 0 off the skin; ``contacts``: `ohmskin.client.points`, four.

    Raises:
        ModelError: If the environment has no MuJoCo data, or there is no such kind.
    """

    def __init__(self, env: Any, sensor: SkinSensor, kind: str = "voltages") -> None:
        super().__init__(env)
        if kind not in KINDS:
            raise ModelError(f"no observation {kind!r}; choose from {', '.join(KINDS)}")
        if not hasattr(env.unwrapped, "data"):
            raise ModelError(f"environment {env} has no MuJoCo `data`; a skin works in MuJoCo environments only")
        self._sensor, self._kind = sensor, kind
        self._raster = Raster(sensor.skin.mesh(), _PIXELS)
        shapes = {
            "voltages": sensor.quiet.shape,
            "image": self._raster.inside.shape,
            "contacts": (len(points((), _MOST)),),
        }
        felt = gymnasium.spaces.Box(-np.inf, np.inf, shapes[kind], np.float32)
        self.observation_space = gymnasium.spaces.Dict({"observation": env.observation_space, "skin": felt})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; noise follows the seed, too."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._sensor.reset(seed)
        return self._with_skin(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Act, then feel once."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._with_skin(observation), reward, terminated, truncated, info

    def _with_skin(self, observation: Any) -> dict[str, Any]:
        sensor, data = self._sensor, self.env.unwrapped.data
        if self._kind == "voltages":
            felt = np.nan_to_num(sensor.voltages([sensor.presses(data)])[0] - sensor.quiet, posinf=0.0, neginf=0.0)
        elif self._kind == "image":
            felt = np.nan_to_num(self._raster(sensor(data).percept.image.values))
        else:
            felt = np.array(points([*map(sensor.patch.contact, sensor(data).contacts)], _MOST))
        return {"observation": observation, "skin": felt.astype(np.float32)}
