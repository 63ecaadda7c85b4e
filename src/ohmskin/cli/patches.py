"""``ohmskin patches``: several skins of one robot, and all they feel as one."""

import sys
import time
from contextlib import ExitStack
from typing import Any

from ohmskin.body.body import Body
from ohmskin.body.patches import Patches
from ohmskin.cli.arrivals import Arrivals
from ohmskin.cli.heartbeat import HEARTBEAT
from ohmskin.cli.options import HERE, Flag, Page, Repeated, Seconds, Stop, check_publishing, refuse_unused, say
from ohmskin.client.contacts import Contacts
from ohmskin.view.overview import Overview

_TABLE_EVERY = 2.0


def patches(
    body: str,
    *,
    publish: Repeated = (),
    page: Page = HERE,
    joints: str = "",
    joint_topic: str = "/joint_states",
    record: str = "",
    replay: str = "",
    demo: bool = True,
    headless: Flag = False,
    seconds: Seconds = None,
) -> None:
    """Sense with all patches of a robot: a process for each, one stream of contacts in the robot's frames, one page.

    Args:
        body: The body file (TOML): the patches and their poses on the robot.
        publish: Publish contacts to zenoh[:PLACE], dds[:INTERFACE], foxglove[:HOST:PORT] or mcap:FILE; may be repeated.
        joints: Receive joint positions from ROS 2: zenoh[:PLACE] or dds[:INTERFACE].
        joint_topic: The topic of these joint states (sensor_msgs/msg/JointState).
        record: Record contacts, images, joint states and links' poses to this MCAP file.
        replay: Replay such a recording instead of sensing; ends with it.
        demo: Let a demonstration finger move over each virtual patch.
        headless: No page.

    A terminal gets a table every two seconds; a file or a pipe gets a line for each change of a patch's state and for
    each new contact.
    """
    loaded = Body.load(body)
    outlets = [*publish, *([f"mcap:{record}"] if record else [])]
    check_publishing(outlets, page, loaded.name)
    page.check("--headless" if headless else "", bool(publish or joints))
    if not joints:
        refuse_unused("without --joints", joint_topic=joint_topic != "/joint_states")
    if not headless and loaded.robot and loaded.robot.unseen:
        say(f"the page does not show meshes, which are on {', '.join(loaded.robot.unseen)}; it shows simple shapes")
    stop = Stop()
    with ExitStack() as stack:
        all_patches = stack.enter_context(
            Patches(
                loaded,
                outlets,
                page.token or None,
                demo,
                shown=not headless,
                joints=joints,
                joint_topic=joint_topic,
                replay=replay,
                report=say,
            )
        )
        say(f"publishing at {', '.join(all_patches.addresses)}")
        if not headless:
            robot = loaded.robot.as_json() if loaded.robot else None
            page.open(stack.enter_context(Overview(loaded.name, all_patches.boards, *page.address, robot)).url)
        end = float("inf") if seconds is None else time.monotonic() + seconds
        table = sys.stdout.isatty()
        stop.listen(silent=not table)
        show = _Table(all_patches) if table else _Changes(all_patches)
        while not stop and not all_patches.ended and time.monotonic() < end:
            show(all_patches.step())


class _Table:
    """A row per patch, every two seconds."""

    def __init__(self, patches: Patches) -> None:
        self._patches = patches
        self._due, self._count = time.monotonic() + _TABLE_EVERY, 0
        self._newest: Contacts | None = None

    def __call__(self, contacts: Contacts | None) -> None:
        self._newest, self._count = contacts or self._newest, self._count + (contacts is not None)
        if (now := time.monotonic()) < self._due or (contacts := self._newest) is None:
            return
        HEARTBEAT.end()  # the table is one from here on
        print(f"{'patch':<16}  {'link':<16}  frames/s  latency p50/p99  contacts  age")
        for seen in contacts.patches:
            status = self._patches.status[seen.patch]
            latency = f"{1e3 * status.get('p50', 0):5.1f} / {1e3 * status.get('p99', 0):4.1f} ms"
            count = sum(contact.patch == seen.patch for contact in contacts.contacts)
            age = f"{seen.age:.2f} s" if seen.sequence else "no frame yet"
            state = "" if status.get("state") == "running" else f"  {_state(status)}"
            patch = f"{seen.patch:<16}  {seen.frame:<16}  {status.get('rate', 0):8.0f}"
            print(f"{patch}  {latency:>15}  {count:8d}  {age}{state}")
        print(f"merged: {self._count / (now - self._due + _TABLE_EVERY):.0f} messages/s\n", flush=True)
        self._due, self._count = now + _TABLE_EVERY, 0


class _Changes:
    """A line for every change of a patch's state, and for every contact that comes."""

    def __init__(self, patches: Patches) -> None:
        self._patches, self._arrivals = patches, Arrivals()
        self._states = dict[str, str]()

    def __call__(self, contacts: Contacts | None) -> None:
        for name, status in self._patches.status.items():
            if (state := _state(status)) != self._states.get(name):
                self._states[name] = state
                say(f"patch {name}: {state}")
        if contacts is None:
            return
        known = {(one.patch, one.id): one for one in contacts.contacts}
        for contact in self._arrivals.new(time.monotonic(), known):
            place = ", ".join(f"{1e3 * value:.0f}" for value in contact.position)
            say(f"contact {contact.id} of {contact.patch} at ({place}) mm in {contact.frame}")


def _state(status: dict[str, Any]) -> str:
    """What a patch reports of itself: its state, or that it has not reported yet."""
    return str(status.get("state", "starting"))
