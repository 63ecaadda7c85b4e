"""The live page: images and contacts in a browser, without ever slowing the loop."""

from ohmskin.view.live import LiveView

__all__ = ["LiveView"]
