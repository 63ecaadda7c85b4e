"""``ohmskin robot``: a robot in skins yields when it is poked."""

import json as json_module
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from rich.console import Console

from ohmskin.body import Body
from ohmskin.cli.options import Flag, check_seed, refuse_unused
from ohmskin.closing import every
from ohmskin.errors import OhmskinError
from ohmskin.sensing import check_parts, mode_named
from ohmskin.skin import Skin

if TYPE_CHECKING:
    from ohmskin.robot import Encounter

T = TypeVar("T")
_MOST = 10_000  # pokes


def robot(
    *,
    body: str = "",
    pokes: int = 10,
    hugs: int = 0,
    self_touches: int = 0,
    free: float = 0.0,
    skin: str = "",
    mode: str = "",
    seed: int = 0,
    strategy: str = "yield",
    max_force: float = math.inf,
    max_reaction: float = math.inf,
    video: Path | None = None,
    picture: Path | None = None,
    json: Flag = False,
) -> None:
    """Poke a robot that wears skins: MuJoCo's contacts press them, the loops sense them, the robot reacts.

    The exit status is 1 if a limit was exceeded.

    Args:
        body: Body file (TOML) of a robot with a URDF file, such as examples/humanoid/body.toml; an arm unless given.
            Its skins are virtual here.
        pokes: Number of pokes, at random places; 0 for the others alone.
        hugs: Then, number of times that pads of two arms press several skins at once, at random places.
        self_touches: Then, number of times that the robot touches itself, in random postures.
        free: Then, time for which it moves untouched (s), to count false contacts.
        skin: Of the arm, a rectangular skin that ships with ohmskin or a .toml file; the paper's unless given.
        mode: Drive mode, such as 16I or 16O; the default mode unless given.
        seed: Seed of the random places.
        strategy: Reaction of the robot to a touch: yield, stop, retract, follow, guide, or stiff (none).
        max_force: Limit of the largest force of a poke (N); none unless given.
        max_reaction: Limit of the time from touch to reaction (s), which an undetected poke exceeds; none unless
            given.
        video: MP4 file to write (needs ffmpeg).
        picture: PNG file to write: the moment of the largest force (needs EGL or OSMesa, as for a video).
        json: Print figures as JSON.
    """
    for name, value in (("pokes", pokes), ("hugs", hugs), ("self-touches", self_touches)):
        if not 0 <= value <= _MOST:
            raise OhmskinError(f"--{name} is {value}; choose 0 to {_MOST}")
    for name, limit, unit in (("max-force", max_force, "N"), ("max-reaction", max_reaction, "s")):
        if not limit > 0:  # NaN likewise
            raise OhmskinError(f"--{name} is {limit} {unit}; choose more than 0, or leave it out for no limit")
    if not 0 <= free <= 36_000:
        raise OhmskinError(f"--free is {free} s; choose 0 to 36000")
    if not pokes:
        if not hugs and not self_touches and not free:
            raise OhmskinError("--pokes is 0; choose 1 or more, or give --hugs, --self-touches or --free")
        limits = {"max-force": max_force < math.inf, "max-reaction": max_reaction < math.inf}
        refuse_unused("with --pokes 0", **limits)
    if body and skin:
        raise OhmskinError("the skins are those of the body file; leave out --skin or --body")
    check_seed(int, seed)
    for path in (video, picture):
        if path is not None and not path.parent.is_dir():
            raise OhmskinError(f"there is no folder {path.parent}; create it first")
    if picture is not None and picture.suffix != ".png":
        raise OhmskinError(f"--picture is {picture}; give a name that ends with .png")
    from ohmskin.robot import Demonstration, Moment, arm, engines, summary  # here: help needs no MuJoCo
    from ohmskin.robot.reach import way_to_itself
    from ohmskin.robot.simulation import RobotSimulation
    from ohmskin.robot.strategies import strategy_named

    poked = Body.load(body) if body else arm(Skin.load(skin or "paper"))
    for placed in poked.patches:
        check_parts(mode_named(placed.skin, mode or placed.mode))
    strategy_named(strategy, poked)
    if video or picture:
        from ohmskin.robot.display import check_display

        check_display()
        from ohmskin.robot.video import SceneRenderer
        from ohmskin.robot.video import snapshot as to_picture
        from ohmskin.robot.video import video as to_video
    console = Console(stderr=True)
    with ExitStack() as stack:
        notify = stack.enter_context(_progress(console))
        if self_touches:  # before an hour of pokes
            notify("looking for postures in which it touches itself")
            way_to_itself(RobotSimulation(poked), np.random.default_rng(seed))
        notify("calibrating" + (f" {len(poked.patches)} skins" if len(poked.patches) > 1 else ""))
        demonstration = Demonstration(poked, stack.enter_context(engines(poked, seed, mode)), seed, strategy)
        shows = []
        if video or picture:
            film = SceneRenderer(demonstration.simulation)
            stack.callback(film.close)
            for file, taken in ((picture, to_picture), (video, to_video)):
                if file:
                    shows.append(stack.enter_context(taken(file, film)))

        def show(moment: Moment) -> None:
            for each in shows:
                each(moment)

        def listed(what: str, made: Iterable[T], total: int) -> list[T]:
            done = list[T]()
            if total:
                notify(f"{what}: 0 of {total} done")
            for one in made:
                done.append(one)
                notify(f"{what}: {len(done)} of {total} done")
            return done

        encounters = listed("pokes", demonstration.pokes(pokes, show), pokes)
        hugged = listed("hugs", demonstration.hugs(hugs, show), hugs)
        touches = listed("self-touches", demonstration.self_touches(self_touches, show), self_touches)
        start = demonstration.simulation.time

        def watch(moment: Moment) -> None:
            notify(f"free motion: {moment.time - start:.0f} of {free:g} s")
            show(moment)

        invented = demonstration.free(free, watch)
    if picture and not picture.exists():
        console.print("no touch was detected; no picture was written")
    figures = summary(encounters, touches, hugged) | {"free_motion": free, "invented_in_free_motion": invented}
    over = [sentence for one in enumerate(encounters, 1) for sentence in _exceeded(*one, max_force, max_reaction)]
    for sentence in over:
        print(sentence, file=sys.stderr)
    if json:
        print(json_module.dumps(figures))
    else:
        _print_report(figures)
    if over:
        sys.exit(1)


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[str], None]]:
    """Yields what is told what is being done: shown at once on a terminal, elsewhere in a line every two seconds."""
    doing = ""

    def notify(what: str) -> None:
        nonlocal doing
        doing = what
        if status:
            status.update(what)

    with ExitStack() as stack:
        status = stack.enter_context(console.status("")) if console.is_terminal else None
        if not status:
            stack.enter_context(every(2.0, lambda: console.print(doing, highlight=False)))
        yield notify


def _print_report(figures: dict[str, Any]) -> None:
    """The figures, line by line."""
    if pokes := figures["pokes"]:
        print(f"{figures['felt']} of {pokes} pokes detected, {figures['on_the_right_link']} on the right link")
    if figures["hugs"]:
        print(
            f"{figures['hugged_skins_felt']} of {figures['hugged_skins']} contacts of {figures['hugs']} hugs detected"
        )
    if figures["self_touches"]:
        print(f"{figures['self_touches_recognised']} of {figures['self_touches']} self-touches recognised")
    if free := figures["free_motion"]:
        print(f"{figures['invented_in_free_motion']} false contacts in {free:g} s of free motion")
    units = {"position_error": (1e3, "mm"), "reaction_time": (1e3, "ms"), "peak_force": (1.0, "N")}
    units |= {"force_error": (1e2, "%")}
    hugs = {f"hug_{name}": unit for name, unit in (units | {"total_force_error": (1e2, "%")}).items()}
    for name, (factor, unit) in (units | hugs).items():
        if (spread := figures[name]) is not None:
            said = ", ".join(f"{key} {factor * value:.1f}" for key, value in spread.items())
            print(f"{name.replace('_', ' '):<21} {said} {unit}")


def _exceeded(number: int, poke: "Encounter", max_force: float, max_reaction: float) -> Iterator[str]:
    """What is said of a poke that exceeds the limits; NaN, of one that was not felt, does."""
    if poke.peak_force > max_force:
        yield f"poke {number}: {poke.peak_force:.1f} N exceeds the limit of {max_force:g} N"
    if max_reaction < math.inf and not poke.reaction <= max_reaction:
        answer = "no reaction" if math.isnan(poke.reaction) else f"a reaction after {poke.reaction:.3f} s"
        yield f"poke {number}: {answer} exceeds the limit of {max_reaction:g} s"
