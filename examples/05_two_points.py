"""
Distinguish two contacts from one
=================================

How far chi-square falls from one fitted disc to two, and how often that distinguishes two contacts.
Run it with ``python examples/05_two_points.py [FOLDER]``.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ohmskin import evaluate
from ohmskin.evaluate.experiments.discrimination import areas
from ohmskin.evaluate.resolution import successes, threshold


def main(folder: Path) -> Path:
    distances = (0.04, 0.03, 0.025, 0.02, 0.015)
    task = evaluate.Discrimination("discs", 50.0, 0.1, 8, areas()[0], distances, methods=("16I", "16O fused"))
    result = task.run()
    right, wrong = successes([result], "test")

    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, rates = figure.subplots(1, 2)
    for m, key in enumerate(task.methods):
        middle = np.median(result["statistic"][m], axis=1)
        (line,) = left.semilogy(1e3 * np.array(distances), np.maximum(middle, 1), "o-", label=key)
        left.axhline(threshold([result])[m, 0, 0], color=line.get_color(), linestyle="--", linewidth=0.8)
        rates.plot(
            1e3 * np.array(distances),
            right[0, m].mean(axis=1),
            "o-",
            label=f"{key}, false twos {100 * wrong[0, m].mean():.0f} %",
        )
        print(
            f"{key:9s} told apart:",
            ", ".join(f"{1e3 * d:.0f} mm {r:.0%}" for d, r in zip(distances, right[0, m].mean(axis=1), strict=True)),
        )
    left.set(xlabel="distance / mm", ylabel="fall of chi-square", title="dashed: threshold for two")
    rates.set(xlabel="distance / mm", ylabel="told apart (share of seeds)", ylim=(-0.05, 1.05), title="50 dB, discs")
    left.legend(frameon=False)
    rates.legend(frameon=False)
    path = folder / "05_two_points.png"
    figure.savefig(path, dpi=150)
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
