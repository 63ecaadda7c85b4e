"""
Learn from touch
================

Distinguish a ball, a rod and a box by the voltages of a skin, simulated by MuJoCo and the virtual skin.
Needs MuJoCo: ``pip install 'ohmskin[robot]'``. Run it with ``python examples/06_learn_from_touch.py [FOLDER]``.
"""

import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure

from ohmskin.plot.colours import AMOUNT
from ohmskin.robot.sensor import SkinSensor

THINGS = {"ball": 'type="sphere" size=".03"', "rod": 'type="capsule" size=".012 .03"'}
THINGS["box"] = 'type="box" size=".03 .02 .012"'
FOAM = 'solref="0.02 1" solimp="0.1 0.9 0.006 0.5 2"'  # gives way as foam does
EACH, TRAINING, FEATURES = 400, 900, 1000


def main(folder: Path) -> Path:
    random = np.random.default_rng(0)
    scenes, truth = [], np.repeat(range(len(THINGS)), EACH)
    for number, thing in enumerate(THINGS.values()):
        table = f'<geom name="table" type="box" size=".12 .12 .01" {FOAM}/>'
        falling = f'<body><freejoint/><geom mass="1" {thing} {FOAM}/></body>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{table}{falling}</worldbody></mujoco>")
        data, sensor = mujoco.MjData(model), SkinSensor(model, "table", mode="16O", seed=1)
        while len(scenes) < EACH * (number + 1):
            mujoco.mj_resetData(model, data)
            data.qpos[:3] = *random.uniform(-0.06, 0.06, 2), 0.045
            turned = [random.uniform(0, np.pi), np.pi / 2 * ("capsule" in thing), 0.0]
            mujoco.mju_euler2Quat(data.qpos[3:7], turned, "zyx")
            mujoco.mj_step(model, data, 250)
            if presses := sensor.presses(data):  # unless it rolled off
                scenes.append(presses)
    changes = sensor.voltages(scenes) - sensor.quiet  # all at once: some thousands a second
    changes /= np.linalg.norm(changes, axis=1, keepdims=True)
    weights = random.normal(0, 1, (changes.shape[1], FEATURES))
    features = np.cos(changes @ weights + random.uniform(0, 2 * np.pi, FEATURES))
    known, unseen = np.split(random.permutation(len(scenes)), [TRAINING])
    gram = features[known].T @ features[known] + np.eye(FEATURES)  # ridge regression
    learned = np.linalg.solve(gram, features[known].T @ np.eye(len(THINGS))[truth[known]])
    told = np.argmax(features[unseen] @ learned, axis=1)
    print(f"{np.mean(told == truth[unseen]):.0%} of {len(unseen)} touches not learned from are classified correctly")
    counts = np.zeros((3, 3), int)
    np.add.at(counts, (truth[unseen], told), 1)
    figure = Figure(figsize=(4, 3.6), layout="constrained")
    panel = figure.subplots()
    figure.colorbar(panel.imshow(counts, cmap=AMOUNT), label="touches")
    panel.set_xticks(range(3), [f"taken for {thing}" for thing in THINGS])
    panel.set_yticks(range(3), THINGS)
    figure.savefig(folder / "06_learned.png", dpi=120)
    return folder / "06_learned.png"


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())))
