"""``ohmskin record``: the loop without a page, into a file."""

from dataclasses import asdict
from pathlib import Path

from ohmskin.cli.live import Stop, run
from ohmskin.cli.options import AS_THE_MODE, Imaging, check_seconds, open_skin, say
from ohmskin.cli.recording import ProgressReport, refuse_existing, reopening, reporting, summary
from ohmskin.device.replay import ReplayDevice
from ohmskin.engine import Engine
from ohmskin.recording.player import Player
from ohmskin.recording.recorder import Recorder


def record(
    file: Path,
    *,
    device: str = "virtual:",
    skin: str = "",
    mode: str = "",
    imaging: Imaging = AS_THE_MODE,
    seconds: float | None = None,
    images: float = 30.0,
) -> None:
    """Record a device: raw frames with the patterns really driven, calibration, contacts, images and health, as MCAP.

    Args:
        file: The recording, such as touch.mcap; an existing file is never overwritten.
        device: Address: virtual:, tcp://HOST:PORT, serial://PORT, replay:FILE.
        skin: A skin that ships with ohmskin (see `ohmskin info`) or a .toml file.
        mode: A mode of the skin, such as 16P or 12B (`ohmskin info` lists them); the most precise one unless given.
        seconds: End after so many seconds; otherwise at Ctrl-C.
        images: Most images per second; they can be made again from the frames.
    """
    check_seconds(seconds)
    refuse_existing(file)
    stop = Stop()
    opened, description = open_skin(device, skin)
    try:
        recorder = Recorder(file, description, images)
    except BaseException:
        opened.close()
        raise
    try:
        source = reopening(opened, device, skin, recorder), description, mode, reporting(recorder, say)
        with Engine(*source, **asdict(imaging)) as engine:
            recorder.watch(engine)
            say(f"{engine.mode.label}; calibrating: keep the skin untouched")
            engine.calibrate()
            say(f"recording to {file}   (Ctrl-C ends)")
            player = Player(engine, mode, say) if isinstance(opened, ReplayDevice) else None
            step, ended = (player.step, player.until(stop)) if player else (engine.step, stop)
            run(step, ended, seconds, recorder.publish, ProgressReport(recorder))
    finally:
        say(summary(file, recorder.close()))
