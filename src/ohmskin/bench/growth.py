"""Figures of bigger skins, each skin and mode measured in a process of its own."""

from collections.abc import Iterator

from ohmskin.bench.bigger import PLACES, SIZES
from ohmskin.bench.clock import Effort, duration
from ohmskin.bench.figure import Figure
from ohmskin.bench.tasks import apart

_RATES = {("O", 64): 300.0, ("O", 256): 15.0, ("T", 64): 600.0, ("T", 256): 60.0}  # targets (1/s)
_MEMORY = {64: 1.0, 256: 3.0}  # GiB


def bigger(effort: Effort) -> Iterator[Figure]:
    """Bigger skins: 36 to 256 electrodes live against the virtual skin, adaptive, most precise and tracking."""
    for electrodes in (36, 64) if effort.quick else SIZES:
        for kind, mode in (("O", "adaptive, with images"), ("P", "most precise"), ("T", "tracking")):
            name = f"{electrodes} electrodes, {mode}"
            found = apart("big_skin", electrodes=electrodes, kind=kind, frames=60 if effort.quick else 300)
            least = _RATES.get((kind, electrodes))
            if "error" in found:
                yield Figure(f"{name}: frames per second", None, "1/s", least=least, note=found["error"])
                continue
            shown = ", ".join(
                f"{count} contacts {duration(p50)} (99 %: {duration(p99)})"
                for count, (p50, p99) in enumerate(found["frames"])
            )
            sizes = f"{found['injections']} injections, {found['measurements']} voltages a frame"
            rate = 1 / found["frames"][1][0]
            note = f"CPU time of the loop, device and link left out; {sizes}; {shown}"
            yield Figure(f"{name}: frames per second, one contact", rate, "1/s", least=least, note=note, data=found)
            note = f"mean of {len(PLACES)} presses of 8 mm, {found['felt']} felt; largest {found['worst'] * 1e3:.2g} mm"
            yield Figure(f"{name}: error of position", found["error_m"] * 1e3, "mm", note=note)
            parts = ", ".join(f"{part} {duration(found[part])}" for part in ("start", "calibration", "image"))
            most = _MEMORY.get(electrodes)
            yield Figure(
                f"{name}: peak memory of the loop", found["peak"] / 1024, "GiB", most=most, note=f"CPU: {parts}"
            )
            if found["accuracy"] is not None:
                what = f"{name}: compiled images against dense float64"
                yield Figure(what, found["accuracy"], "", most=5e-5, note="largest error over the largest value")
