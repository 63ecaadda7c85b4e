"""Forces that others measure: a load cell on a serial line, a force sensor of ROS 2."""

import math
import re
import threading
from collections.abc import Callable

import serial

from ohmskin.client.cdr import CdrDecoder
from ohmskin.errors import DataError, DeviceLost, PublishError
from ohmskin.outlets.joints import subscribe
from ohmskin.outlets.outlet import check_outlet

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LONGEST = 200  # bytes of a line
_BAUD = re.compile(r"serial://([^?]+)(?:\?baud=(\d+))?")


def open_load_cell(source: str, topic: str, report: Callable[[float], None]) -> Callable[[], None]:
    """Tell every force (N) of a source from now on; gives what ends that.

    Args:
        source: ``serial://PORT``, with ``?baud=`` unless it is 115200, whose lines end with a number of newtons; or
            ``zenoh[:PLACE]`` or ``dds[:INTERFACE]``, where ROS 2 publishes a `geometry_msgs/msg/WrenchStamped`.
        topic: Its topic.
        report: Called in a thread.

    Raises:
        DeviceLost: If the port cannot be opened.
        PublishError: If there is no such source, its extra is missing, or the place cannot be used.
    """
    if source.startswith("serial://"):
        return _listen_to_line(source, report)
    if source.partition(":")[0] not in ("zenoh", "dds"):
        raise PublishError(f"forces cannot be read from {source!r}; choose serial://PORT, zenoh, dds or a .csv file")
    check_outlet(source)

    def take(message: bytes) -> None:
        try:
            decoder = CdrDecoder(message)
            decoder.stamp()
            decoder.text()
            report(math.hypot(*decoder.take("ddd")))
        except DataError:
            return  # it grows old, which is what its reader looks at

    return subscribe(source, topic, "geometry_msgs/WrenchStamped", None, take)[1]


def _listen_to_line(source: str, report: Callable[[float], None]) -> Callable[[], None]:
    found = _BAUD.fullmatch(source)
    if found is None:
        raise PublishError(f"{source!r} names no serial port; use serial://PORT or serial://PORT?baud=9600")
    try:
        line = serial.serial_for_url(found[1], baudrate=int(found[2] or 115200), timeout=0.1)
    except (serial.SerialException, OSError, ValueError) as error:
        raise DeviceLost(f"cannot open the load cell at {found[1]}: {error}") from error
    over = threading.Event()

    def listen() -> None:
        text = b""
        while not over.is_set():
            try:
                text += line.read_until(b"\n", _LONGEST)  # or what came of a line in time
            except (serial.SerialException, OSError):  # unplugged: the last reading grows old
                return
            if text.endswith(b"\n") or len(text) >= _LONGEST:
                if numbers := _NUMBER.findall(text.decode("ascii", "replace")):
                    report(float(numbers[-1]))
                text = b""

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()
        line.close()

    return end
