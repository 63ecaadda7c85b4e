"""Writes seeds for the fuzzer: the vectors of docs/protocol.md, as a raw stream and as requests to be packed."""

import re
import sys
from pathlib import Path

from cobs import cobs

VECTORS = Path(__file__).parents[2] / "docs" / "protocol.md"


def main(folder: Path) -> None:
    """Write one file for each vector and form, and for a whole conversation."""
    folder.mkdir(parents=True, exist_ok=True)
    found = re.findall(r"^\| ([A-Z]+) \| \d+ \| `([0-9a-f]+)` \|$", VECTORS.read_text(encoding="utf-8"), re.M)
    raw = {name: bytes.fromhex(packet) for name, packet in found}
    packed = {name: _request(packet) for name, packet in raw.items()}
    order = ("HELLO", "PATTERN", "SCAN", "PRESS", "SCAN")
    raw["conversation"] = b"".join(raw[name] for name in order)
    packed["conversation"] = b"".join(packed[name] for name in order)
    for name, data in raw.items():
        (folder / f"raw-{name}").write_bytes(b"\0" + data)
    for name, data in packed.items():
        (folder / f"packed-{name}").write_bytes(b"\1" + data)


def _request(packet: bytes) -> bytes:
    body = cobs.decode(packet[:-1])
    payload = body[4:-4]
    return bytes([body[1] & 0x3F, len(payload)]) + payload


if __name__ == "__main__":
    main(Path(sys.argv[1]))
