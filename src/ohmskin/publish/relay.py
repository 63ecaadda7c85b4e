"""The loop's end of the publishing process."""

import json
import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from ohmskin.errors import PublishError
from ohmskin.publish.outlet import check_outlet

log = logging.getLogger(__name__)

_STOP_TIMEOUT = 3.0


class RelayProcess:
    """A process that publishes what is on some boards. Nothing here waits for it once it runs.

    Args:
        name, pictures, scale, token: See `ohmskin.publish.process.Relay`.
        outlets: See `open_outlet`; with none but ``shm`` there is no process at all.
        picture_rate: Most images per second.

    Attributes:
        addresses: Where its outlets are.

    Raises:
        PublishError: If an outlet cannot be opened.
    """

    def __init__(
        self,
        name: str,
        pictures: Sequence[str],
        scale: float | None,
        outlets: Sequence[str],
        token: str | None,
        picture_rate: float,
    ) -> None:
        for address in outlets:
            check_outlet(address)
        self.addresses: list[str] = []
        self._process: subprocess.Popen[bytes] | None = None
        outlets = [address for address in dict.fromkeys(outlets) if address != "shm"]
        if not outlets:
            return
        self._process = process = subprocess.Popen(
            [sys.executable, "-P", "-m", "ohmskin.publish.process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path), "OMP_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C is the loop's to handle; the process ends when its input does
            bufsize=0,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        settings = {"name": name, "pictures": list(pictures), "scale": scale, "outlets": outlets, "token": token}
        text = json.dumps({**settings, "picture_every": 1 / picture_rate}).encode()
        with suppress(OSError):  # it has ended already, which the missing answer tells
            process.stdin.write(len(text).to_bytes(4, "little") + text)
        answer: dict[str, Any] = {}
        with suppress(ValueError):
            answer = json.loads(process.stdout.readline())
        if "ready" not in answer:
            self.close()
            why = answer.get("failed", f"its process ended (exit status {process.returncode})")
            raise PublishError(str(why) if "failed" in answer else f"publishing cannot start: {why}")
        self.addresses = answer["ready"]
        self._in = process.stdin.fileno()
        os.set_blocking(self._in, False)

    def wake(self) -> None:
        """Tell it that there is something new; never waits."""
        if self._process is None:
            return
        try:
            os.write(self._in, b".")
        except BlockingIOError:  # it has much to read still, and will find the newest
            pass
        except OSError:
            log.error("the publishing process has ended (exit status %s); the loop goes on without it", self._process.poll())
            self.close()

    def close(self) -> None:
        """End the process. Safe twice."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()
        try:
            process.wait(_STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
