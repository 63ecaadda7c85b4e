"""Child processes: each ends with its standard input, and so with the process that started it, however that ends."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any, Self, cast


class Child:
    """A running child process.

    Args:
        command: What to run; `module` makes a child of one of our modules.
        name: What to call it in messages.
        settings: What it gets first: nothing secret stands in a command, which others on the machine can read.
        environment: Added to ours.
        stdout, stderr, pass_fds: As for `subprocess.Popen`.

    Attributes:
        process: The process.
        stdin, stdout: Its pipes, which are not buffered.
    """

    def __init__(
        self,
        command: Sequence[str],
        name: str,
        settings: Mapping[str, Any] | None = None,
        environment: Mapping[str, str] | None = None,
        stdout: int = subprocess.PIPE,
        stderr: int | None = None,
        pass_fds: Sequence[int] = (),
    ) -> None:
        self._name = name
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=stdout,
            stderr=stderr,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), **(environment or {})},
            process_group=0,  # Ctrl-C is ours to handle; of the same session, or its niceness would mean nothing
            bufsize=0,
            pass_fds=pass_fds,
        )
        self.stdin, self.stdout = cast(IO[bytes], self.process.stdin), cast(IO[bytes], self.process.stdout)
        if settings is not None:
            text = json.dumps(settings).encode()
            view = memoryview(len(text).to_bytes(4, "little") + text)
            try:
                with suppress(BrokenPipeError):  # it has ended already, which the missing answer tells
                    while view:
                        view = view[os.write(self.stdin.fileno(), view) :]
            except BaseException:
                self.close(0.0)
                raise

    @classmethod
    def module(cls, module: str, name: str, settings: Mapping[str, Any], **environment: str) -> Self:
        """A module of ours, whose `main` begins with `begin`."""
        return cls([sys.executable, "-P", "-m", module], name, settings, environment)

    def ready(self, timeout: float, failure: Callable[[str], Exception]) -> dict[str, Any]:
        """Its first answer, awaited for `timeout` seconds at most.

        Raises:
            Exception: What `failure` makes of the reason, if there is no answer or it is ``failed``; it is ended then.
        """
        why = f"{self._name} gave no answer within {timeout:g} s"
        lines: list[bytes] = []
        reader = threading.Thread(target=lambda: lines.append(self.stdout.readline()), daemon=True)
        try:
            reader.start()  # a thread, because not every system can wait for a pipe
            reader.join(timeout)
            if lines and lines[0]:
                answer: dict[str, Any] = json.loads(lines[0])
                if "failed" not in answer:
                    return answer
                why = str(answer["failed"])
            elif lines:
                with suppress(subprocess.TimeoutExpired):
                    self.process.wait(timeout)
                why = f"{self._name} ended (exit status {self.process.returncode})"
            raise failure(why)
        except BaseException:
            self.end(0.0)
            if reader.ident is not None:
                reader.join()
            self.close()
            raise

    def stop(self) -> None:
        """Ask it to end."""
        with suppress(OSError):
            self.stdin.close()

    def end(self, timeout: float) -> None:
        """Ask it to end, and kill it if it has not after so many seconds."""
        self.stop()
        try:
            self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def close(self, timeout: float = 3.0) -> None:
        """End it and let go of its pipes. Safe to call twice."""
        self.end(timeout)
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()


def begin(waits: bool = True) -> tuple[dict[str, Any], Callable[..., None]]:
    """In the child: its settings, and a function that answers (keywords become a line of JSON).

    If it never `waits`, short answers (4 KiB) that nobody has read for long are lost.
    From here on Ctrl-C is the parent's to handle, and what a library prints goes to standard error.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.dup(sys.stdout.fileno())
    if not waits:
        os.set_blocking(answers, False)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def answer(**what: object) -> None:
        with suppress(OSError):  # nobody listens any more; standard input ends next
            os.write(answers, json.dumps(what).encode() + b"\n")

    length = int.from_bytes(_exactly(4), "little")
    return json.loads(_exactly(length)), answer


def when_input_ends(then: Callable[[], object]) -> None:
    """Do something as soon as standard input ends, in a thread."""

    def wait() -> None:
        while os.read(0, 65536):
            pass
        then()

    threading.Thread(target=wait, daemon=True).start()


def _exactly(count: int) -> bytes:
    data = b""
    while len(data) < count:
        if not (more := os.read(0, count - len(data))):
            raise SystemExit
        data += more
    return data
