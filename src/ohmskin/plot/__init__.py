"""Pictures: images of a skin with electrodes and contacts, for files and papers."""

from ohmskin.plot.picture import draw_image, save_picture

__all__ = ["draw_image", "save_picture"]
