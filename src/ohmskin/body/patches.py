"""All patches of a robot: a process for each, and one stream of contacts in the robot's frames."""

import json
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from io import BufferedReader
from typing import IO, Any

from ohmskin.body.body import Body, PlacedSkin
from ohmskin.body.posture import Posture
from ohmskin.body.replay import BodyReplay
from ohmskin.child import Child
from ohmskin.client.board import Board, BoardReader
from ohmskin.client.contacts import (
    LARGEST,
    Contacts,
    Patch,
    PatchState,
    PlacedContact,
    merged,
    pack,
    patches_from,
    unpack,
)
from ohmskin.closing import Closing
from ohmskin.errors import PublishError
from ohmskin.outlets.joints import JointsProcess
from ohmskin.outlets.publisher import check_settings
from ohmskin.outlets.relay import RelayProcess

_RESTART_AFTER = 1.0
_STOP_TIMEOUT = 3.0  # s, for all of them together
_WAIT, _WAIT_REPLAYING = 5e-3, 5e-4  # s for new contacts, before joint states are looked at, or what is due in a replay
_LOOK_EVERY = 0.1  # s between two looks at whether processes have ended
_DRAWN = 30.0  # images per second that a page draws


class PatchProcess:
    """One patch in a process of its own, started anew when it ends by itself.

    Args:
        placed: The patch.
        name: Its boards.
        demo: Whether a demonstration finger presses a virtual one.
        images: Most images per second.
        news: Set whenever it says something, such as that there is something new on its boards.
        report: Called with every message for the user.

    Attributes:
        status: Its last report: state, rate (1/s), p50 and p99 of the latency (s), message.
    """

    def __init__(
        self,
        placed: PlacedSkin,
        name: str,
        demo: bool,
        images: float,
        news: threading.Event,
        report: Callable[[str], None],
    ) -> None:
        self._settings = {
            "patch": asdict(placed.patch),
            "skin": placed.skin.dump(),
            "device": placed.device,
            "mode": placed.mode,
            "name": name,
            "demo": demo and placed.device == "virtual:",
            "images": images,
        }
        self._patch, self._news, self._report = placed.patch.name, news, report
        self.status: dict[str, Any] = {}
        self._again = 0.0  # when to start anew; 0 while it runs
        self._start()

    def poll(self) -> None:
        """Start it anew if it has ended."""
        if (status := self._child.process.poll()) is None:
            return
        if self._again == 0:
            self._again = time.monotonic() + _RESTART_AFTER
            why = self.status.get("failed", f"exit status {status}")
            self.status = {"state": "lost", "message": str(why)}
            self._report(f"patch {self._patch} has ended ({why}); restarting it")
        elif time.monotonic() > self._again:
            self.close(0.0)
            self._start()

    def stop(self) -> None:
        """Ask it to end."""
        self._child.stop()

    def close(self, timeout: float = _STOP_TIMEOUT) -> None:
        """End it; kill it if it has not ended after so many seconds. Safe to call twice."""
        self._child.end(timeout)
        self._thread.join()
        self._child.close()

    def _start(self) -> None:
        self._again = 0.0
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._child = Child.module("ohmskin.body.patch", "the patch", self._settings, **threads)
        self._thread = threading.Thread(target=self._listen, args=(self._child.stdout,), daemon=True)
        self._thread.start()

    def _listen(self, stdout: IO[bytes]) -> None:
        with BufferedReader(stdout) as lines:  # type: ignore[type-var]
            for line in lines:
                with suppress(ValueError):
                    told = json.loads(line)
                    if told.get("message") and told["message"] != self.status.get("message"):
                        self._report(f"patch {self._patch}: {told['message']}")
                    self.status = self.status | told
                self._news.set()


class Patches(Closing):
    """All patches of a body, merged into one stream of contacts.

    Args:
        body: What there is.
        outlets: Where to publish beside shared memory; see `ohmskin.outlets.outlet.open_outlet`.
        token: Password for listeners on other machines, where the protocol has passwords.
        demo: Whether a demonstration finger presses each virtual patch.
        images: Most images per second of each patch.
        shown: Whether a page shows them: then there are 30 a second in shared memory, whatever outlets get.
        joints: How joint states are received, ``zenoh`` or ``dds``; from a program that uses `JointStates` unless
            given.
        joint_topic: Topic of the joint states (`sensor_msgs/msg/JointState`).
        replay: A recording of the body to replay instead of reading its devices.
        report: Called with every message for the user.

    Attributes:
        addresses: Where outlets are.
        boards: Names of the shared memory of each patch.

    Raises:
        PublishError: If the body's name is taken, an outlet cannot be opened, or joint states cannot be received.
    """

    def __init__(
        self,
        body: Body,
        outlets: Sequence[str] = (),
        token: str | None = None,
        demo: bool = False,
        images: float = 10.0,
        shown: bool = False,
        joints: str = "",
        joint_topic: str = "/joint_states",
        replay: str = "",
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        check_settings(token, images)
        if joints and body.robot is None:
            raise PublishError("joint states need a body with a URDF file; name one in the body file")
        self.body = body
        self.boards = [f"{body.name}.{placed.patch.name}" for placed in body.patches]
        self._processes: list[PatchProcess] = []
        self._look_at = 0.0
        pictures = [f"{board}.image" for board in self.boards]
        with ExitStack() as stack:
            patches = [placed.patch for placed in body.patches]
            posture = None if body.robot is None else stack.enter_context(Posture(body, report))
            self._merger = Merger(body.name, patches, self.boards, posture)
            stack.enter_context(self._merger)
            root = "" if body.robot is None else body.robot.root
            self._relay = RelayProcess(body.name, pictures, patches, outlets, token, images, root)
            stack.enter_context(self._relay)
            self.addresses = [f"shm:{body.name}", *self._relay.addresses]
            if joints and body.robot is not None:
                heard = JointsProcess(body.name, body.robot.independent, joints, joint_topic, token)
                report(f"receiving joint states at {stack.enter_context(heard).address}, {joint_topic}")
            self._replay = stack.enter_context(BodyReplay(body, replay)) if replay else None
            self._news = threading.Event()
            stack.callback(self._end_processes)
            drawn = max(images, _DRAWN) if shown else images
            for placed, board in zip(body.patches, self.boards, strict=True) if not replay else ():
                self._processes.append(PatchProcess(placed, board, demo, drawn, self._news, report))
            self._stack = stack.pop_all()

    @property
    def status(self) -> dict[str, dict[str, Any]]:
        """The last report of each patch; see `PatchProcess`."""
        names = [placed.patch.name for placed in self.body.patches]
        if self._replay is not None:
            return {name: {"state": "running"} for name in names}
        return {name: process.status for name, process in zip(names, self._processes, strict=True)}

    @property
    def ended(self) -> bool:
        """Whether a recording has been replayed to its end."""
        return self._replay is not None and self._replay.ended

    def step(self) -> Contacts | None:
        """Forward new contacts; None, after a wait for some of 5 ms at most, if there are none."""
        if (now := time.monotonic()) >= self._look_at:
            self._look_at = now + _LOOK_EVERY
            for process in self._processes:
                process.poll()
        if self._replay is not None:
            self._replay.step()
        if (merged := self._merger.step()) is None:
            self._news.wait(_WAIT if self._replay is None else _WAIT_REPLAYING)
            self._news.clear()
        else:
            self._relay.wake()
        return merged

    def close(self) -> None:
        """End all processes and remove the shared memory. Safe to call twice."""
        self._stack.close()

    def _end_processes(self) -> None:
        for process in self._processes:
            process.stop()
        end = time.monotonic() + _STOP_TIMEOUT
        for process in self._processes:
            process.close(max(0.0, end - time.monotonic()))


class Merger(Closing):
    """Makes one stream of several boards.

    Args:
        name: The board that is written.
        patches: All patches.
        boards: Their boards.
        posture: How the robot stands, from which self-touch is determined; None: that is not known.

    Raises:
        PublishError: If the name is taken.
    """

    def __init__(
        self, name: str, patches: Sequence[Patch], boards: Sequence[str], posture: Posture | None = None
    ) -> None:
        self._posture = posture
        self._patches = tuple(patches)
        self._readers = [BoardReader(board) for board in boards]
        self._seen = [PatchState(patch.name, patch.frame) for patch in patches]
        self._contacts: list[tuple[PlacedContact, ...]] = [()] * len(patches)
        self._sequence = 0
        self._board = Board(name, {"patches": [asdict(patch) for patch in patches], "boards": list(boards)}, LARGEST)

    def step(self) -> Contacts | None:
        """Publish the contacts of all patches, if one of them has new ones.

        The contacts of a patch that has fallen silent stay as they were, with the time since its last frame.
        """
        if self._posture is not None:
            self._posture.step()
        news = False
        for number, reader in enumerate(self._readers):
            # the name may have been another program's, or have been left by one that had the patch elsewhere
            own = (self._patches[number],)
            if (record := reader.newest()) is not None and (told := patches_from(reader.setup)) == own:
                news = True
                found = unpack(record, told, reader.boot)
                self._seen[number], self._contacts[number] = found.patches[0], found.contacts
        if not news:
            return None
        self._sequence += 1
        contacts: Sequence[PlacedContact] = [contact for own in self._contacts for contact in own]
        if self._posture is not None:
            contacts = self._posture.with_self_touch(contacts)
        newest = merged(self._sequence, self._seen, contacts, self._board.boot)
        self._board.write(pack(newest, self._patches))
        return newest

    def close(self) -> None:
        """Let go of all boards. Safe to call twice."""
        for reader in self._readers:
            reader.close()
        self._board.close()
