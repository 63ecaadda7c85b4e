"""Pictures of the studies, from results alone."""

import ohmskin.plot  # noqa: F401 (which says what to install if Matplotlib is missing)
