"""
Image a touch
=============

Press the virtual skin in two places, image it, and find the contacts.
Run it with ``python examples/02_image_a_touch.py [FOLDER]``.
"""

import sys
import tempfile
from pathlib import Path

import ohmskin as ohm
from ohmskin.plot import save_picture


def main(folder: Path) -> Path:
    skin = ohm.Skin.load("paper")
    pattern = ohm.adjacent(skin.electrodes.rings)  # as in mode 16I
    virtual = ohm.VirtualSkin(skin, seed=1)

    quiet = [virtual.scan(pattern) for _ in range(20)]
    baseline = ohm.Baseline.learn(quiet)
    estimator = ohm.GaussNewton(skin.transfer_model(), baseline.noise, amplitude=0.1, model_error=0.02)

    virtual.press(0, x=0.06, y=0.14, radius=8e-3, pressure=20e3)  # metres, pascals
    virtual.press(1, x=0.14, y=0.08, radius=8e-3, pressure=10e3)
    image = estimator.reconstruct(baseline.difference(virtual.scan(pattern)))

    contacts = ohm.ContactFinder(threshold=0.02).find(image, estimator.model.mesh)
    for contact in contacts:
        x, y = contact.position
        print(f"({1e3 * x:.1f}, {1e3 * y:.1f}) mm, {1e4 * contact.extent:.1f} cm2, confidence {contact.confidence:.2f}")
    path = folder / "02_touch.png"
    save_picture(
        path, estimator.model.mesh, image.values, skin.electrodes, contacts, "Two fingers, adjacent drive (16I)"
    )
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
