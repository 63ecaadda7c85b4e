"""The live page: what the robot feels, in a browser, without ever slowing the loop."""

from ohmskin.view.live import LiveView
from ohmskin.view.wire import ViewError

__all__ = ["LiveView", "ViewError"]
