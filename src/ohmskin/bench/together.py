"""Eight skins of one robot on one machine, as `ohmskin patches` runs them: how many frames each, for how much work."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from ohmskin.bench.clock import Effort
from ohmskin.bench.figure import Figure
from ohmskin.client import Client, Contacts

_PATIENCE, _SETTLING, _MEASURED = 600.0, 3.0, 15.0  # s
_LEAST = 200.0  # frames per second of each


def together(effort: Effort) -> Iterator[Figure]:
    """Eight skins on one body, virtual ones included, all tracking while fingers wander over them."""
    count = 2 if effort.quick else 8
    name = f"{count} skins tracking on {os.cpu_count()} cores, each"
    if not Path("/proc/self/stat").is_file():
        yield Figure(f"{name}: frames per second", None, "1/s", least=_LEAST, note="needs /proc")
        return
    with TemporaryDirectory() as folder:
        body = Path(folder) / "body.toml"
        patch = '[[patch]]\nname = "p{}"\nlink = "base"\ndevice = "virtual:"\nmode = "16T"\n'
        body.write_text("\n".join(['name = "bench"', *(patch.format(k) for k in range(count))]), encoding="utf-8")
        command = [sys.executable, "-m", "ohmskin", "patches", str(body), "--headless"]
        with (
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process,
            closing(Client("shm:bench")) as client,
        ):
            try:
                rates, spent = _measured(process, client, count)
            finally:
                process.terminate()
    if not rates:
        yield Figure(f"{name}: frames per second", None, "1/s", least=_LEAST, note=f"none in {_PATIENCE:g} s")
        return
    note = f"the slowest of them, wall clock; {', '.join(f'{rate:.0f}' for rate in rates)}; needs idle cores"
    yield Figure(f"{name}: frames per second", min(rates), "1/s", least=_LEAST, note=note)
    note = "CPU time of all processes over the frames of all skins: loops, links, virtual skins, merging"
    yield Figure(f"{name}: work for a frame", 1e3 * spent / (sum(rates) * _MEASURED), "ms", note=note)


def _measured(process: "subprocess.Popen[bytes]", client: Client, count: int) -> tuple[list[float], float]:
    """Frames per second of each skin, once all run, and the CPU seconds of all processes meanwhile."""
    end = time.monotonic() + _PATIENCE
    while (contacts := client.newest()) is None or min(_sequences(contacts)) == 0:
        if process.poll() is not None or time.monotonic() > end:
            return [], 0.0
        time.sleep(0.1)
    time.sleep(_SETTLING)
    begun, before, spent = time.monotonic(), client.newest(), _spent(process.pid)
    time.sleep(_MEASURED)
    after, elapsed = client.newest(), time.monotonic() - begun
    assert before is not None
    assert after is not None
    frames = [late - early for late, early in zip(_sequences(after), _sequences(before), strict=True)]
    return [number / elapsed for number in frames], (_spent(process.pid) - spent) * _MEASURED / elapsed


def _sequences(contacts: Contacts) -> list[int]:
    return [seen.sequence for seen in contacts.patches]


def _spent(root: int) -> float:
    """CPU seconds of a process and all that it, and these, started and that still run."""
    parents, ticks = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        number = int(stat.parent.name)
        parents[number], ticks[number] = int(fields[1]), int(fields[11]) + int(fields[12])
    family = {root}
    while more := {number for number, parent in parents.items() if parent in family} - family:
        family |= more
    return sum(ticks.get(number, 0) for number in family) / os.sysconf("SC_CLK_TCK")
