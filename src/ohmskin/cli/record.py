"""``ohmskin record``: the loop without a page, into a file."""

from pathlib import Path

from ohmskin.cli.live import Stop, run
from ohmskin.cli.options import open_skin, say
from ohmskin.cli.recording import Teller, refuse_existing, summary
from ohmskin.device import Device
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine
from ohmskin.errors import OhmskinError
from ohmskin.publish.player import Player
from ohmskin.publish.recorder import Recorder


def record(
    file: Path,
    *,
    device: str = "virtual:",
    skin: str = "",
    mode: str = "",
    seconds: float | None = None,
    images: float = 30.0,
) -> None:
    """Record a device: raw frames with the patterns really driven, calibration, contacts, images and health, as MCAP.

    Parameters
    ----------
    file
        The recording, such as touch.mcap; an existing file is never overwritten.
    device
        Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE.
    skin
        A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.
    mode
        Drive mode, such as 12B, 16I or 16O; the skin's best unless given.
    seconds
        End after so many seconds; otherwise at Ctrl-C.
    images
        Most images per second; they can be made again from the frames.
    """
    if seconds is not None and not seconds > 0:
        raise OhmskinError(f"--seconds is {seconds:g}; it must be positive")
    refuse_existing(file)
    stop = Stop()
    opened, description = open_skin(device, skin)
    first: list[Device] = [opened]

    def open_device() -> Device:
        return recorder.tee(first.pop() if first else open_skin(device, skin)[0])

    def report(sentence: str) -> None:
        recorder.note(sentence)
        say(sentence)

    try:
        recorder = Recorder(file, description, images)
    except BaseException:
        opened.close()
        raise
    try:
        with Engine(open_device, description, mode, report=report) as engine:
            recorder.watch(engine)
            say("calibrating: keep the skin untouched")
            engine.calibrate()
            say(f"recording to {file}   (Ctrl-C ends)")
            player = Player(engine, mode, say) if isinstance(opened, ReplayDevice) else None
            step, ended = (player.step, player.until(stop)) if player else (engine.step, stop)
            run(step, ended, seconds, recorder.publish, Teller(recorder))
    finally:
        say(summary(file, recorder.close()))
