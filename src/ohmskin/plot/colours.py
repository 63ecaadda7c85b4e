"""The colours of all pictures: those of the live page.

Both halves of `SIGNED` lead from near white at zero in equal steps of lightness (OKLab) to full scale; hue tells the
sign. `AMOUNT` is the positive half, in which more is always darker: of a change of conductivity, an error, a count.
`GLOWING` is the same of dark backgrounds, where more is always brighter.
"""

import numpy as np
from matplotlib.colors import ListedColormap

from ohmskin.arrays import Floats

Stops = tuple[tuple[float, float, float], ...]

# OKLCH lightness, chroma, hue (degrees) at equal distances from zero to full scale, as in view/static/colour.js
_ZERO, _DARK = (0.975, 0.006, 95), (0.19, 0.015, 285)
POSITIVE: Stops = (_ZERO, (0.85, 0.11, 82), (0.72, 0.17, 56), (0.59, 0.2, 32), (0.46, 0.17, 8), (0.33, 0.13, -20))
NEGATIVE: Stops = (_ZERO, (0.85, 0.055, 200), (0.72, 0.1, 222), (0.59, 0.13, 243), (0.46, 0.14, 262), (0.33, 0.12, 275))
DARK: Stops = (_DARK, (0.35, 0.12, 305), (0.51, 0.19, 350), (0.66, 0.19, 388), (0.81, 0.15, 427), (0.96, 0.09, 462))

_STEPS = 256  # per sign
_LMS = np.array([[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.291485548]])
_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.707614701],
    ]
)


def ramp(stops: Stops) -> Floats:
    """Colours (256, 3) from zero to full scale in sRGB, 0 to 1 (OKLab: Ottosson 2020)."""
    at, known = np.linspace(0, 1, _STEPS), np.linspace(0, 1, len(stops))
    lightness, chroma, hue = (np.interp(at, known, column) for column in np.array(stops, float).T)
    linear = _linear(lightness, chroma, hue)
    while (beyond := ((linear < -0.001) | (linear > 1.001)).any(axis=1)).any():  # what no screen shows loses chroma
        chroma[beyond] *= 0.95
        linear = _linear(lightness, chroma, hue)
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _linear(lightness: Floats, chroma: Floats, hue: Floats) -> Floats:
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    return np.asarray((np.column_stack([lightness, a, b]) @ _LMS.T) ** 3 @ _RGB.T)


AMOUNT = ListedColormap(ramp(POSITIVE), "ohmskin amount")
SIGNED = ListedColormap(np.vstack([ramp(NEGATIVE)[::-1], ramp(POSITIVE)]), "ohmskin signed")
GLOWING = ListedColormap(ramp(DARK), "ohmskin glowing")
