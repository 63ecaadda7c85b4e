"""Forces that others measure: a load cell on a serial line, a force sensor of ROS 2."""

import logging
import math
import re
import threading
from collections.abc import Callable

import serial

from ohmskin.client.cdr import CdrDecoder
from ohmskin.errors import DataError, DeviceLost, PublishError, shown
from ohmskin.outlets.joints import subscribe
from ohmskin.outlets.outlet import check_outlet

log = logging.getLogger(__name__)

_FORCE = re.compile(
    r"(?!.*(?i:err|fail|fault|overl))"  # a number behind such a word is a code
    r"(?:.*?(?:[\s;:=]|(?<!\d),))?"  # a comma between digits may be a decimal one: such a line has no force
    r"([-+]?)\s*((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*N?",
    re.ASCII,
)
_ENDS = re.compile(rb"[\r\n]+")
_LONGEST = 200  # bytes at the end of a line that are looked at
_RULE = "lines must end with a number of newtons, such as 12.5, F=12.5 or 12.5 N (decimal point); others are not used"
_BAUD = re.compile(r"serial://([^?]+)(?:\?baud=(\d+))?")


def open_load_cell(
    source: str, topic: str, report: Callable[[float], None], fail: Callable[[str, bool], None] = lambda *_: None
) -> Callable[[], None]:
    """Tell every force (N) of a source from now on; gives what ends that.

    Args:
        source: ``serial://PORT``, with ``?baud=`` unless it is 115200, whose lines end with a number of newtons, as
            `force_of` reads them, a first other one being logged; or ``zenoh[:PLACE]`` or ``dds[:INTERFACE]``, where
            ROS 2 publishes a `geometry_msgs/msg/WrenchStamped`.
        topic: Its topic.
        report: Called in a thread.
        fail: Likewise, with why a message has no force, and whether the source is lost for good.

    Raises:
        DeviceLost: If the port cannot be opened.
        PublishError: If there is no such source, its extra is missing, or the place cannot be used.
    """
    if source.startswith("serial://"):
        return _listen_to_line(source, report, fail)
    if source.partition(":")[0] not in ("zenoh", "dds"):
        raise PublishError(f"forces cannot be read from {source!r}; choose serial://PORT, zenoh, dds or a .csv file")
    check_outlet(source)

    def take(message: bytes) -> None:
        try:
            decoder = CdrDecoder(message)
            decoder.stamp()
            decoder.text()
            report(math.hypot(*decoder.take("ddd")))
        except DataError as error:
            fail(str(error), False)  # it grows old, which is what its reader looks at

    return subscribe(source, topic, "geometry_msgs/WrenchStamped", None, take)[1]


def force_of(line: str) -> float | None:
    """The force (N) that a load cell's line ends with, such as ``12.5``, ``F=-4.5e0 N`` or ``ST, + 3.25``; else None.

    Args:
        line: Without blanks round it. Before the number comes a blank, ``;``, ``:``, ``=``, or a comma that follows no
            digit directly; after it ``N`` or nothing. A line that tells of an error has no force.
    """
    found = _FORCE.fullmatch(line)
    force = float(found[1] + found[2]) if found else math.inf
    return force if math.isfinite(force) else None


def _listen_to_line(
    source: str, report: Callable[[float], None], fail: Callable[[str, bool], None]
) -> Callable[[], None]:
    found = _BAUD.fullmatch(source)
    if found is None:
        raise PublishError(f"{source!r} names no serial port; use serial://PORT or serial://PORT?baud=9600")
    try:
        line = serial.serial_for_url(found[1], baudrate=int(found[2] or 115200), timeout=0.1)
    except (serial.SerialException, OSError, ValueError) as error:
        raise DeviceLost(f"cannot open the load cell at {found[1]}: {error}") from error
    port, over = found[1], threading.Event()

    def listen() -> None:
        text, told = b"", False
        while not over.is_set():
            try:
                text += line.read_until(b"\n", _LONGEST)  # or what came of a line in time
            except (serial.SerialException, OSError) as error:  # unplugged: the last reading grows old
                return fail(str(error), True)
            *lines, text = _ENDS.split(text)
            text = text[-_LONGEST:]
            for one in [part.decode("ascii", "replace").strip() for part in lines]:
                if (force := force_of(one)) is not None:
                    report(force)
                elif one:
                    fail(f"there is no force in the line {shown(one)}; {_RULE}", False)
                    if not told:
                        told = True
                        log.warning("no force in the line %s of %s; %s", shown(one), port, _RULE)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()
        line.close()

    return end
