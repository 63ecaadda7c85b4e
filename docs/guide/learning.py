"""A skin that differs from its model: judge its channels without labels, then learn positions from known presses.

python docs/guide/learning.py [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import ohmskin as ohm
from ohmskin.calibrate import judge_channels, learn_positions, read_places
from ohmskin.plot.learned import save_learned
from ohmskin.skin import Calibration

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(".")
random = np.random.default_rng(1)
described = ohm.Skin.load("paper-rim16")

# the real one: electrodes up to 4 mm off on the rim, a sheet uneven by about 20 %, two injections without information
places = described.electrodes.positions.copy()
for place in places:
    along = 0 if place[1] in (0.0, 0.2) else 1
    place[along] = np.clip(place[along] + random.uniform(-4e-3, 4e-3), 0, 0.2)
uneven = tuple(random.normal(0, 0.08, 36))
found = Calibration("2026-11-23", made_for=described.digest, positions=tuple(map(tuple, places.tolist())))
real = ohm.VirtualSkin(replace(described, calibration=replace(found, log_conductivity=(0.0, *uneven[1:]))), seed=1)
pattern = ohm.adjacent([range(16)])
silent = np.isin(pattern.measurements[:, 0], (3, 10))


def scan() -> ohm.Frame:
    """What is measured, with noise in place of what the dead injections would measure."""
    frame = real.scan(pattern)
    return replace(frame, voltages=frame.voltages + silent * random.normal(0, 5e-3, pattern.n_meas))


quiet = [scan() for _ in range(20)]
pressed = random.uniform(0.012, 0.188, (160, 2))
frames = []
for place in pressed:
    real.press(1, *place, radius=7e-3, pressure=15e3)
    frames.append(scan())
    real.press(1, *place, radius=7e-3, pressure=0.0)

# 1. all presses, without their places: which channels follow the model?
judged = judge_channels(described, quiet, frames)
print("\n".join(judged.report()))
skin = replace(described, calibration=judged.put_into(described.calibration))

# 2. places of all of them: a map; errors are of presses that were not learned from (cross-validation)
known = ohm.SkinModel(skin, skin.transfer_model(), quiet)
report = learn_positions(pattern, *read_places(known, frames), pressed, size=0.2)
print("\n".join(report.report()))
learned = replace(skin, calibration=replace(skin.calibration, position_map=report.map.dump()))
(folder / "learned.toml").write_text(learned.dump())

# for comparison: the skin as described, all channels alike
plain = ohm.SkinModel(described, described.transfer_model(), quiet)
away = np.linalg.norm(read_places(plain, frames)[0] - pressed, axis=1)
print(f"as described: mean error {1e3 * np.nanmean(away):.2f} mm, {np.isnan(away).sum()} not detected")
save_learned(folder / "learning.png", described, judged, report, pressed)
print(folder / "learning.png")
