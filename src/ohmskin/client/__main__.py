"""`python -m ohmskin.client` prints the folder of `ohmskin.hpp`, the client of control loops in C++."""

from pathlib import Path

print(Path(__file__).parent)
