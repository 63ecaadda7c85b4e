"""``ohmskin robot``: an arm with a skin yields when it is poked."""

import json as json_module
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.progress import track

from ohmskin.cli.options import Flag, check_seed
from ohmskin.device import connect
from ohmskin.engine import Engine
from ohmskin.errors import OhmskinError
from ohmskin.skin import Skin


def robot(
    *,
    pokes: int = 10,
    skin: str = "paper",
    mode: str = "",
    seed: int = 0,
    yielding: bool = True,
    video: Path | None = None,
    picture: Path | None = None,
    json: Flag = False,
) -> None:
    """Poke a robot arm that wears the skin: MuJoCo's contacts press it, the loop senses them, the arm yields.

    Args:
        pokes: Number of pokes, at random places.
        skin: A rectangular skin that ships with ohmskin or a .toml file.
        mode: Drive mode, such as 16I or 16O; the skin's best unless given.
        seed: Seed of the random places.
        yielding: Let the arm yield; --no-yielding shows the forces without.
        video: MP4 file to write (needs ffmpeg).
        picture: PNG file to write: the moment of the largest force (needs EGL or OSMesa, as for a video).
        json: Print figures as JSON.
    """
    if not 1 <= pokes <= 10_000:
        raise OhmskinError(f"--pokes is {pokes}; choose 1 to 10000")
    check_seed(int, seed)
    for path in (video, picture):
        if path is not None and not path.parent.is_dir():
            raise OhmskinError(f"there is no folder {path.parent}; make it first")
    description = Skin.load(skin)
    from ohmskin.robot import Demonstration, Moment, summary  # here: help needs no MuJoCo

    if video or picture:
        from ohmskin.robot.display import check_display
        from ohmskin.robot.film import Film
        from ohmskin.robot.film import snapshot as to_picture
        from ohmskin.robot.film import video as to_video

        check_display()
    console = Console(stderr=True)
    with ExitStack() as stack:
        engine = stack.enter_context(
            Engine(lambda: connect("virtual:", skin=description, seed=seed, realtime=False), description, mode)
        )
        engine.calibrate()
        demonstration = Demonstration(engine, seed, yielding)
        shows = []
        if video or picture:
            film = Film(description, demonstration.arm)
            stack.callback(film.close)
            for file, taken in ((picture, to_picture), (video, to_video)):
                if file:
                    shows.append(stack.enter_context(taken(file, film)))

        def show(moment: Moment) -> None:
            for each in shows:
                each(moment)

        encounters = list(track(demonstration.pokes(pokes, show), "poking", total=pokes, console=console))
    if picture and not picture.exists():
        console.print("no poke was felt; no picture was written")
    figures = summary(encounters)
    if json:
        print(json_module.dumps(figures))
        return
    print(f"{figures['felt']} of {pokes} pokes felt")
    for name, factor, unit in (("position_error", 1e3, "mm"), ("reaction_time", 1e3, "ms"), ("peak_force", 1.0, "N")):
        if (spread := figures[name]) is not None:
            assert isinstance(spread, dict)
            said = ", ".join(f"{key} {factor * value:.1f}" for key, value in spread.items())
            print(f"{name.replace('_', ' '):<15} {said} {unit}")
