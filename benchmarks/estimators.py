"""Where estimators put a touch: errors in millimetres, side by side, on data that no estimator's own model made.

    python -m benchmarks.estimators [--places 25] [--seed 0]

The worlds are those of `ohmskin.evaluate`: discs of raised conductivity (radius 10 mm, +50 %), and patches pressed on
the sheet (8 mm, 20 kPa). Scan: adjacent drive on all 16 electrodes of the paper's grid (16I). Images are read by the
centroid of the part above half the peak, fitted contacts by the strongest one. Prior amplitude 0.1, one noise level for
all; GREIT, which does not know the noise, is given the noise figure that suits it (1 at 50 dB, 0.4 at 40 dB).
"""

import argparse
import json
from time import perf_counter

import numpy as np

from ohmskin.contacts import ContactFitter
from ohmskin.evaluate import worlds
from ohmskin.evaluate.setup import setup
from ohmskin.forward import ContactTable, TransferModel
from ohmskin.inverse import (
    PRIORS,
    AbsoluteGaussNewton,
    GaussNewton,
    Greit,
    SparseBayes,
    TotalVariation,
)
from ohmskin.scan import Baseline, Difference, Frame, adjacent

AMPLITUDE, MODEL_ERROR = 0.1, {"discs": 0.0, "pressed": 0.02}
FIGURES = {50: 1.0, 40: 0.4}  # noise figures


def estimators(
    model: TransferModel, noise: float, error: float, baseline: Baseline, figure: float
) -> dict[str, object]:
    settings = {"amplitude": AMPLITUDE, "model_error": error}
    return {
        **{f"Gauss-Newton, {name}": GaussNewton(model, noise, name, **settings) for name in PRIORS},
        "Gauss-Newton, matern, positive": GaussNewton(model, noise, "matern", positive=True, **settings),
        "GREIT": Greit(model, noise, noise_figure=figure),
        "iterated Gauss-Newton": AbsoluteGaussNewton(model, noise, "matern", baseline=baseline, **settings),
        "total variation": TotalVariation(model, noise, amplitude=0.5, outline=0.01, model_error=error),
        "total variation, positive": TotalVariation(
            model, noise, amplitude=0.5, outline=0.01, model_error=error, positive=True
        ),
        "sparse Bayes": SparseBayes(model, noise, amplitude=0.5, model_error=error),
        "contacts fitted": ContactFitter(ContactTable(model, radius=0.01), noise, model_error=error),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--places", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    places = np.random.default_rng(options.seed).uniform(0.025, 0.175, (options.places, 2))
    result: dict[str, dict[str, list[float]]] = {}
    for world in worlds.WORLDS:
        model, untouched = setup(world, 50).model, worlds.sheet(world, "grid").untouched
        pattern = adjacent(model.electrodes.rings)
        quiet = worlds.voltages(untouched, pattern)
        currents = np.full(pattern.n_inj, worlds.CURRENT)
        baseline = Baseline.learn([Frame(pattern, quiet, currents, 0.0)] * 2)
        for decibels in (50, 40):
            noise = worlds.noise_volts(world, decibels)
            for name, estimator in estimators(model, noise, MODEL_ERROR[world], baseline, FIGURES[decibels]).items():
                errors, took = [], 0.0
                for k, place in enumerate(places):
                    rng = np.random.default_rng([options.seed, k, decibels])
                    touched = worlds.touched(world, "grid", (worlds.contact(world, *place),))
                    volts = worlds.voltages(touched, pattern) + noise * rng.standard_normal(pattern.n_meas)
                    difference = Difference(pattern, np.full(pattern.n_meas, worlds.CURRENT), volts - quiet)
                    start = perf_counter()
                    if isinstance(estimator, ContactFitter):
                        contacts = estimator.contacts(estimator.fit(difference))
                        found = np.array(contacts[0].position) if contacts else np.full(2, np.inf)
                    else:
                        data = (
                            Frame(pattern, volts, currents, 0.0)
                            if isinstance(estimator, AbsoluteGaussNewton)
                            else difference
                        )
                        values = estimator.reconstruct(data).values
                        mass = np.where(values > values.max() / 2, values, 0) * model.mesh.measures
                        found = mass @ model.mesh.centroids / mass.sum()
                    took += perf_counter() - start
                    errors.append(1e3 * float(np.linalg.norm(found - place)))
                seen = np.array(errors)[np.isfinite(errors)]
                key = f"{world} {decibels} dB"
                result.setdefault(name, {})[key] = [
                    seen.mean(),
                    float(np.median(seen)),
                    len(errors) - len(seen),
                    1e3 * took / len(errors),
                ]
    print(
        f"{'mean / median error, mm (missed)':34s}"
        + "".join(f"{key:>22s}" for key in next(iter(result.values())))
        + "   ms"
    )
    for name, row in result.items():
        cells = "".join(f"{mean:12.1f} /{median:5.1f} ({missed})" for mean, median, missed, _ in row.values())
        print(f"{name:34s}{cells}{max(cell[3] for cell in row.values()):8.1f}")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
