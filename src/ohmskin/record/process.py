"""The writer's process: takes messages from its standard input, so that neither packing nor a slow disk holds up the loop.

`ohmskin.record.pipe` is the other end. First come a length (4 bytes) and JSON with path, metadata and attachments, then messages.
"""

import json
import os
import select
import sys
import time
from contextlib import suppress
from typing import BinaryIO

from ohmskin.record.pipe import PREFIX
from ohmskin.record.writer import RecordingWriter


def main(source: BinaryIO, answers: BinaryIO) -> None:
    """Write what comes down the pipe until it ends, whoever ended it, and say now and then how it goes."""

    def say(**answer: object) -> None:
        with suppress(OSError):  # nobody listens any more
            answers.write(json.dumps(answer).encode() + b"\n")
            answers.flush()

    begin = json.loads(_exactly(source, int.from_bytes(_exactly(source, 4), "little")))
    try:
        writer = RecordingWriter(begin["path"], begin["metadata"], begin["attachments"])
    except OSError as error:
        say(failed=error.strerror or str(error))
        return
    say(ready=True)
    told = time.monotonic()
    buffer = bytearray()
    descriptor = source.fileno()
    while True:
        ready, _, _ = select.select([descriptor], [], [], writer.wait)
        if ready:
            data = os.read(descriptor, 2**20)
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
        if time.monotonic() - told > 0.2:
            told = time.monotonic()
            say(written=writer.disk.written, frames=writer.frames, lost=writer.lost, trouble=writer.disk.trouble)
    writer.close()
    say(written=writer.disk.written, frames=writer.frames, lost=writer.lost, trouble=writer.disk.trouble, closed=True)


def _exactly(source: BinaryIO, count: int) -> bytes:
    data = b""
    while len(data) < count:
        if not (more := os.read(source.fileno(), count - len(data))):
            raise SystemExit
        data += more
    return data


if __name__ == "__main__":
    main(sys.stdin.buffer, sys.stdout.buffer)
