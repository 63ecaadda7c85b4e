"""``python -m ohmskin``."""

from ohmskin.cli import main

main()
