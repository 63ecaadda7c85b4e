"""``ohmskin image``: a picture of a recording."""

from pathlib import Path

from ohmskin.drive import Mode
from ohmskin.engine import Perception
from ohmskin.plot import save_picture
from ohmskin.record import read_recording
from ohmskin.skin import Skin


def image(file: Path, *, skin: str = "", output: Path | None = None) -> None:
    """Make a picture of a recording's frame, with its contacts.

    Parameters
    ----------
    file
        The recording.
    skin
        A skin that ships with ohmskin or a .toml file; the one that fits the format unless given.
    output
        Where to put the picture; beside the recording's name in this folder unless given.
    """
    recording = read_recording(file)
    description = Skin.load(skin or recording.skin)
    quiet, frame = recording.quiet, recording.frames[0]
    perception = Perception(description, description.transfer_model(), quiet)
    mode = Mode("recorded", "the recording's own pattern", frame.pattern)
    perception.learn_thresholds(mode, lambda _: quiet[0], len(quiet))
    sight = perception.see(mode, lambda _: frame)
    target = output or Path(file.stem + ".png")
    mesh, electrodes = perception.model.mesh, description.electrodes
    save_picture(target, mesh, sight.image.values, electrodes, sight.contacts, file.parent.name.replace("_", " "))
    for contact in sight.contacts:
        x, y = contact.position
        change = "conducts better" if contact.strength > 0 else "conducts worse"
        print(
            f"({x * 1e3:6.1f}, {y * 1e3:6.1f}) mm  {contact.extent * 1e4:5.2f} cm2  {change}, confidence {contact.confidence:.2f}"
        )
    print(f"picture: {target}")
