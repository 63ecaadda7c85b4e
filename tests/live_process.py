"""`ohmskin live` as a user runs it, for tests."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def live(*arguments: str, port: int = 0) -> Iterator[tuple[str, "subprocess.Popen[str]", str]]:
    """The page's address, the process of `ohmskin live`, which must end cleanly when asked, and what it said so far."""
    command = [sys.executable, "-m", "ohmskin", "live", "--no-browser", "--port", str(port), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    try:
        seen = []
        for line in process.stdout:
            seen.append(line)
            if found := re.search(r"http://\S+", line):
                break
        else:
            raise AssertionError(f"ohmskin live ended: {''.join(seen)}")
        yield found[0], process, "".join(seen)
        process.send_signal(signal.SIGTERM)
        rest = process.communicate(timeout=300)[0]
        assert process.returncode == 0, rest
        assert "Traceback" not in rest
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@contextmanager
def serving(*arguments: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """The last address that `ohmskin serve-skin` prints, and its process, which must end cleanly when asked."""
    command = [sys.executable, "-m", "ohmskin", "serve-skin", "--port", "0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        lines = [process.stdout.readline() for _ in range(1 + ("--pty" in arguments))]
        found = re.search(r"(tcp|serial)://\S+", lines[-1])
        assert found, lines
        yield found[0], process
        process.terminate()
        assert process.wait(120) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def children(pid: int) -> list[int]:
    """Process numbers of all that descend from a process."""
    import psutil

    return [child.pid for child in psutil.Process(pid).children(recursive=True)]


def all_gone(pids: list[int], within: float = 60.0) -> bool:
    """Whether all these processes end within some seconds."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if not any(_alive(pid) for pid in pids):
            return True
        time.sleep(0.05)
    return False


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
