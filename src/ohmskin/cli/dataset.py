"""``ohmskin dataset``: simulated touches for learning."""

import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ohmskin.cli.options import Jobs, Scheduler, SkinName
from ohmskin.dataset import Recipe, generate
from ohmskin.skin import Skin


def dataset(
    output: Path,
    /,
    *,
    count: int = 10_000,
    skin: SkinName = "paper",
    pattern: str = "complete",
    contacts: tuple[int, int] = (0, 3),
    radius: tuple[float, float] = (4.0, 15.0),
    pressure: tuple[float, float] = (1.0, 60.0),
    gap: float = 5.0,
    pixels: int = 32,
    seed: int = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = "",
) -> None:
    """Simulate touches for learning: voltages, truth and parameters, in a Zarr group. Run it again for more.

    Args:
        output: Folder of the data set; created if it does not exist.
        count: Total number of samples.
        pattern: Pattern to drive: "complete" (all electrode pairs, which contains every pattern) or a mode such as 16I
            (its base scan).
        contacts: Least and largest number of contacts.
        radius: Least and largest radius (mm).
        pressure: Least and largest pressure (kPa).
        gap: Least distance between the rims of two contacts (mm).
        pixels: Pixels of the truth along the longer side.
        seed: Seed of everything: the same seed gives the same data on any number of workers.
    """
    metres, pascals = (1e-3 * radius[0], 1e-3 * radius[1]), (1e3 * pressure[0], 1e3 * pressure[1])
    recipe = Recipe(Skin.load(skin).dump(), pattern, contacts, metres, pascals, 1e-3 * gap, pixels, seed)
    console, started = Console(), time.monotonic()
    columns = (TextColumn("samples"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("samples", total=count)
        made = generate(output, recipe, count, jobs, scheduler, lambda done, _: progress.update(bar, completed=done))
    seconds = time.monotonic() - started
    console.print(f"{made} samples made in {seconds:.0f} s, {count} in {output}", highlight=False, soft_wrap=True)
