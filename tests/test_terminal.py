"""Commands in a terminal: a sign of life every three seconds, and a clean end at Ctrl-C."""

import os
import pty
import re
import select
import signal
import sys
import time
from pathlib import Path

import psutil
import pytest
from test_documentation import with_presses

BODY = Path(__file__).parents[1] / "examples" / "body" / "body.toml"
RECORDING = Path("recordings", "touch.mcap")  # of `ohmskin examples`
COMMANDS = {
    "live": "live --no-browser --port 0",
    "calibrate": "calibrate --output mine.toml",
    "patches": f"patches {BODY} --no-browser --port 0",
    "layout": "layout",
    "learn": "learn presses.csv --skin my-skin.toml",
    "robot": "robot --pokes 5",
    "reproduce": "reproduce --quick --jobs 2",
    "policies": "policies --quick --jobs 2",
    "bench": "bench --quick",
}
MOMENTS = [(name, 1.0 if name == "learn" else 3.0) for name in COMMANDS] + [
    ("live", 0.4),
    ("live", 8.0),
    ("policies", 0.4),
    ("calibrate", 8.0),
]
_LONGEST = 600.0  # s, that a command may take on a busy machine, where it compiles all
ENDING = ("live --headless --seconds 1", "calibrate --places 2 --weights 200 500", f"image {RECORDING}")


class Terminal:
    """A command in a pseudo-terminal.

    Args:
        command: What is typed behind `ohmskin`.
        folder: Where.

    Attributes:
        text: What it printed.
        silence: The longest time without output, s.
        late: By how much this process itself was kept waiting at worst, s.
    """

    def __init__(self, command: str, folder: Path, **environment: str) -> None:
        self.text, self.silence, self.late = "", 0.0, 0.0
        self._pid, self._fd = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            arguments = [sys.executable, "-m", "ohmskin", *command.split()]
            os.execvpe(sys.executable, arguments, {**os.environ, "TERM": "xterm", **environment})
        self._last = time.monotonic()

    def read(self, seconds: float) -> bool:
        """Take what it prints for so long (s); whether it still runs."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            asked, wait = time.monotonic(), min(left, 0.1)
            ready, _, _ = select.select([self._fd], [], [], wait)
            self.late = max(self.late, time.monotonic() - asked - wait)
            self.silence = max(self.silence, time.monotonic() - self._last)
            if ready:
                self._last = time.monotonic()
                try:
                    data = os.read(self._fd, 65536)
                except OSError:  # it has ended
                    return False
                self.text += data.decode(errors="replace")
        return True

    def interrupt(self) -> list[psutil.Process]:
        """Press Ctrl-C, and return the processes that it has by then."""
        children = psutil.Process(self._pid).children(recursive=True)
        os.write(self._fd, b"\x03")
        return children

    def end(self) -> int:
        """Its exit status, as a shell gives it; it is killed if it does not end."""
        if self.read(_LONGEST):
            os.kill(self._pid, signal.SIGKILL)
        os.close(self._fd)
        status = os.waitstatus_to_exitcode(os.waitpid(self._pid, 0)[1])
        return status if status >= 0 else 128 - status


@pytest.mark.parametrize(("name", "after"), MOMENTS)
def test_ctrl_c_ends_a_command_without_a_traceback_or_a_child(name: str, after: float, tmp_path: Path) -> None:
    if name == "learn":
        with_presses(tmp_path)
    terminal = Terminal(COMMANDS[name], tmp_path)
    runs = terminal.read(after)
    children = terminal.interrupt() if runs else []
    status = terminal.end()
    assert status in (130, *((0,) if name in ("live", "patches") else ()), *(() if runs else (2,))), terminal.text
    assert "Traceback" not in terminal.text
    assert re.split(r"\^C", terminal.text)[-1].count("ohmskin:") == 0
    _, left = psutil.wait_procs(children, timeout=20)
    assert [child for child in left if child.status() != psutil.STATUS_ZOMBIE] == []


def test_a_sign_of_life_comes_every_three_seconds_while_all_is_compiled(tmp_path: Path) -> None:
    """Each command compiles what those before it have not needed. Where no test has compiled anything, all is kept."""
    kept = Path(os.environ["NUMBA_CACHE_DIR"])
    cache = tmp_path / "cache" if kept.is_dir() and any(kept.iterdir()) else kept
    assert Terminal("examples", tmp_path).end() == 0
    for command in ENDING:
        terminal = Terminal(command, tmp_path, NUMBA_CACHE_DIR=str(cache))
        assert terminal.end() == 0, terminal.text
        assert terminal.silence < 3.0 + terminal.late, terminal.text
