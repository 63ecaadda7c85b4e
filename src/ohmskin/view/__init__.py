"""The live page: what the robot feels, in a browser, without ever slowing the loop."""

from ohmskin.view.live import LiveView

__all__ = ["LiveView"]
