"""What a file of tests leaves behind when its last test is over: threads that hold the process, and child processes."""

import threading
import time

import psutil


class Leftovers:
    """Watches this process from its making on; what was there before is no concern of it."""

    def __init__(self) -> None:
        self._threads = set(threading.enumerate())
        self._children = {child.pid for child in psutil.Process().children()}

    def keep(self) -> None:
        """Take what is there now for granted: a session's browser, say."""
        self._threads |= set(threading.enumerate())
        self._children |= {child.pid for child in psutil.Process().children()}

    def threads(self) -> list[threading.Thread]:
        """Threads that would keep the process from ending."""
        return [t for t in threading.enumerate() if t not in self._threads and t.is_alive() and not _ends_by_itself(t)]

    def children(self) -> list[psutil.Process]:
        """Child processes that nobody has ended, zombies left out."""
        return [child for child in psutil.Process().children() if child.pid not in self._children and _runs(child)]

    def end(self, patience: float = 5.0) -> list[str]:
        """Wait for what is about to end, kill what does not, and describe what did not; a thread cannot be killed, and
        is described once."""
        until = time.monotonic() + patience
        while (self.threads() or self.children()) and time.monotonic() < until:
            time.sleep(0.02)
        said = [f"thread {thread.name}" for thread in self.threads()]
        for child in self.children():
            try:
                said.append(f"process {child.pid}: {' '.join(child.cmdline())[:200]}")
                for process in [*child.children(recursive=True), child]:
                    process.kill()
                child.wait(5)
            except psutil.Error:
                continue
        self._threads |= set(self.threads())
        return said


def _ends_by_itself(thread: threading.Thread) -> bool:
    from concurrent.futures.thread import _threads_queues  # pools are told to end when the interpreter does

    return thread.daemon or thread in _threads_queues


def _runs(child: psutil.Process) -> bool:
    helpers = ("resource_tracker", "multiprocessing.forkserver")  # multiprocessing's own end with us
    try:
        return child.status() != psutil.STATUS_ZOMBIE and not any(name in " ".join(child.cmdline()) for name in helpers)
    except psutil.Error:
        return False
