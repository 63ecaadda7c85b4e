"""Child processes: they tell, they end with us, and a start that fails leaves nothing behind."""

import os
import subprocess
import sys
import threading
import time

import psutil
import pytest

from ohmskin.child import Child
from ohmskin.errors import PublishError

ECHO = """
import os
from ohmskin.child import begin
settings, answer = begin()
print("noise")
answer(got=settings)
os.read(0, 1)
"""


def child(code: str, settings: dict[str, object] | None = None) -> Child:
    return Child([sys.executable, "-c", code], "the child", settings)


def children() -> set[int]:
    return {process.pid for process in psutil.Process().children()}


def test_settings_arrive_and_answers_come_back() -> None:
    large = {"text": "x" * 300_000}  # more than a pipe holds
    started = child(ECHO, large)
    assert started.ready(60, PublishError) == {"got": large}
    started.close()
    started.close()
    assert started.process.returncode == 0


def test_one_that_never_waits_goes_on_though_nobody_reads_and_what_is_read_is_whole() -> None:
    begin = "from ohmskin.child import begin; answer = begin(waits=False)[1]"
    started = child(f"{begin}; [answer(state='running') for _ in range(9999)]", {})
    started.process.wait(60)
    lines = started.stdout.read().splitlines()
    started.close()
    assert {*lines} == {b'{"state": "running"}'}
    assert 100 < len(lines) < 9999


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("raise SystemExit(7)", r"the child ended \(exit status 7\)"),
        ("from ohmskin.child import begin; begin()[1](failed='no such thing')", "no such thing"),
        ("import time; time.sleep(600)", "gave no answer within 0.5 s"),
    ],
)
def test_a_start_that_fails_says_why_and_leaves_nothing_behind(code: str, says: str) -> None:
    before, threads = children(), threading.active_count()
    with pytest.raises(PublishError, match=says):
        child(code, {}).ready(0.5 if "sleep" in code else 60.0, PublishError)
    assert children() == before
    assert threading.active_count() == threads


def test_ctrl_c_is_not_for_a_child_which_can_give_way_all_the_same() -> None:
    started = child(ECHO, {})
    try:
        assert os.getpgid(started.process.pid) == started.process.pid  # a terminal interrupts a group
        assert os.getsid(started.process.pid) == os.getsid(0)  # Linux holds niceness against others of a session only
    finally:
        started.close()


def test_a_child_that_does_not_listen_is_killed() -> None:
    started = child("import os, time\nos.write(1, b'{}\\n')\nwhile True: time.sleep(1)")
    assert started.ready(60, PublishError) == {}
    started.close(0.1)
    assert started.process.returncode == -9


def test_a_child_ends_with_its_parent_however_that_ends() -> None:
    code = f"from ohmskin.child import Child; import sys, os; c = Child([sys.executable, '-c', {ECHO!r}], 'x', {{}})\n"
    code += "c.ready(60, OSError); print(c.process.pid, flush=True); os.kill(os.getpid(), 9)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    pid = int(done.stdout)
    end = time.monotonic() + 60
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end
        time.sleep(0.01)
