"""The writer's process: takes messages from standard input; neither packing nor a slow disk holds up the loop.

`ohmskin.mcap.pipe` is the other end: path, metadata and attachments come first, then messages.
"""

import os
import select
import time

from ohmskin.child import begin
from ohmskin.mcap.schemas import PREFIX
from ohmskin.mcap.writer import RecordingWriter


def main() -> None:
    """Write what comes down the pipe until it ends, whoever ended it, and say now and then how it goes."""
    settings, answer = begin()
    try:
        writer = RecordingWriter(**settings)
    except OSError as error:
        answer(failed=error.strerror or str(error))
        return
    answer(ready=True)

    def report(**more: object) -> None:
        answer(
            written=writer.disk.written,
            frames=writer.disk.frames,
            lost=writer.lost,
            trouble=writer.disk.trouble,
            **more,
        )

    reported = time.monotonic()
    buffer = bytearray()
    while True:
        ready, _, _ = select.select([0], [], [], writer.wait)
        if ready:
            data = os.read(0, 2**20)
            if not data:
                break
            buffer += data
            at = 0
            while len(buffer) - at >= PREFIX.size:
                topic, sequence, stamp, length = PREFIX.unpack_from(buffer, at)
                end = at + PREFIX.size + length
                if len(buffer) < end:
                    break
                writer.add(topic, sequence, stamp, bytes(buffer[at + PREFIX.size : end]))
                at = end
            del buffer[:at]
        if (left := writer.wait) is not None and left <= 0:
            writer.flush()
        elif writer.disk.trouble:
            writer.disk.commit()
        if time.monotonic() - reported > 0.2:
            reported = time.monotonic()
            report()
    writer.close()
    report(closed=True)


if __name__ == "__main__":
    main()
