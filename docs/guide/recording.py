"""Record a press, replay it, and let two estimators look at the same frames.

python docs/guide/recording.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

import ohmskin as ohm
from ohmskin.recording import Recorder, reimage
from ohmskin.recording.export import save_comparison, strongest

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
file = folder / "recording.mcap"
skin = ohm.Skin.load("paper")

with (
    Recorder(file, skin) as recorder,
    ohm.Engine(lambda: recorder.tee(ohm.connect("virtual:", skin=skin, seed=1)), skin) as engine,
):
    recorder.watch(engine)  # so that the file has the mode of each frame
    engine.calibrate()
    engine.press(1, (0.06, 0.12), radius=8e-3, pressure=20e3)
    for _ in range(10):
        recorder.publish(engine.step())
print(f"{recorder.progress.frames} frames, {recorder.progress.written} bytes")

# the same frames, once as the live loop saw them and once with another prior
first = strongest(reimage(file))
other = next(reimage(file, prior="matern", start=first.time))
save_comparison(folder / "recording.png", {"paper": first, "matern": other})

# without ohmskin: any MCAP reader, and the layout in the file's own schemas
with file.open("rb") as stream:
    schema, channel, message = next(make_reader(stream).iter_messages(topics=["/ohmskin/frame"]))
    count = int.from_bytes(message.data[48:52], "little")
    voltages = np.frombuffer(message.data, "<f8", count, offset=52)
    print(f"{channel.topic} ({schema.name}): {count} voltages, the first {voltages[0]:.6f} V")
print(folder / "recording.png")
