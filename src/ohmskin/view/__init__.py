"""The live page: images and contacts in a browser, which never slows the loop."""

from ohmskin.view.live import LiveView

__all__ = ["LiveView"]
