"""Writes the headers that are made of the Python tables: protocol, analogue link, test vectors.

`--check` only compares.
"""

import re
import sys
import zlib
from collections.abc import Mapping
from enum import IntEnum, IntFlag
from pathlib import Path

from ohmskin.device import analogue
from ohmskin.device.capabilities import Feature
from ohmskin.device.layout import CHECKSUM, HEADER, LAYOUTS, MAX_PACKET, VERSION, MessageKind, PacketLayout
from ohmskin.device.messages import ErrorCode
from ohmskin.device.press import RANGES
from ohmskin.scan import FrameFlag

HERE = Path(__file__).parent
_TYPES = {"u8": "uint8_t", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t", "f32": "float"}
_SIZES = {"u8": 1, "u16": 2, "u32": 4, "u64": 8, "f32": 4}


def main() -> int:
    """Write the headers, or tell which are stale."""
    headers = {
        HERE / "core" / "protocol_layout.h": protocol_header(),
        HERE / "targets" / "qemu" / "analogue_layout.h": analogue_header(),
        HERE / "tests" / "vectors.h": vectors_header(),
    }
    stale = [path for path, text in headers.items() if not path.exists() or path.read_text() != text]
    if "--check" in sys.argv[1:]:
        for path in stale:
            print(f"{path.relative_to(HERE)} is stale; run: python firmware/generate.py", file=sys.stderr)
        return 1 if stale else 0
    for path in stale:
        path.write_text(headers[path])
        print(f"wrote {path.relative_to(HERE)}")
    return 0


def protocol_header() -> str:
    """Constants and layouts of docs/protocol.md."""
    lines = [
        "/* Sent before the payload of every packet. */",
        "typedef struct __attribute__((packed)) {",
        "    uint8_t version;",
        "    uint8_t kind;",
        "    uint16_t sequence;",
        "} message_header_t;",
        "",
        f"#define PROTOCOL_VERSION {VERSION}",
        f'#define PROTOCOL_VERSION_TEXT "{VERSION}"',
        f"#define MAX_PACKET {MAX_PACKET}",
        f"#define HEADER_BYTES {HEADER.size}",
        f"#define CHECKSUM_BYTES {CHECKSUM.size}",
        '_Static_assert(sizeof(message_header_t) == HEADER_BYTES, "packed");',
        "",
        *_enum("KIND", MessageKind),
        *_enum("ERROR", ErrorCode),
        *_enum("FEATURE", Feature),
        *_enum("FLAG", FrameFlag),
    ]
    for name, (low, high) in RANGES.items():
        lines += [f"#define PRESS_{name.upper()}_MIN {low!r}f", f"#define PRESS_{name.upper()}_MAX {high!r}f"]
    lines.append("")
    for kind, layout in LAYOUTS.items():
        lines += _layout(kind.name, layout)
    return _header("PROTOCOL_LAYOUT_H", "ohmskin.device.layout", lines)


def analogue_header() -> str:
    """The link between the emulated firmware and its analogue side."""
    lines = [f"#define ANALOGUE_REPLY 0x{analogue.REPLY:02X}", "", *_enum("ANALOGUE", analogue.AnalogueKind)]
    for kind, (request, reply) in analogue.LAYOUTS.items():
        lines += _layout(f"ASK_{kind.name}", request)
        lines += _layout(f"TELL_{kind.name}", reply)
    return _header("ANALOGUE_LAYOUT_H", "ohmskin.device.analogue", lines)


def vectors_header() -> str:
    """The packets of docs/protocol.md."""
    document = (HERE.parent / "docs" / "protocol.md").read_text(encoding="utf-8")
    lines = []
    for name, sequence, packet in re.findall(r"^\| ([A-Z]+) \| (\d+) \| `([0-9a-f]+)` \|$", document, re.M):
        data = bytes.fromhex(packet)
        lines.append(f"/* sequence {sequence} */")
        lines += _bytes(f"VECTOR_{name}", data)
    found = re.search(r"digest is (0x[0-9A-F]{8})", document)
    assert found, "docs/protocol.md tells no digest"
    check = zlib.crc32(b"123456789")
    lines += [f"#define VECTOR_DIGEST {found[1]}u", f"#define VECTOR_CRC 0x{check:08X}u"]
    return _header("VECTORS_H", "docs/protocol.md", lines)


def _header(guard: str, source: str, lines: list[str]) -> str:
    body = "\n".join(lines).rstrip()
    return (
        f"/* Made by firmware/generate.py from {source}; change it there. */\n"
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n\n{body}\n\n#endif\n"
    )


def _enum(prefix: str, members: type[IntEnum] | type[IntFlag]) -> list[str]:
    named: Mapping[str, IntEnum | IntFlag] = members.__members__
    return ["enum {", *(f"    {prefix}_{name} = 0x{int(value):02X}," for name, value in named.items()), "};", ""]


def _layout(name: str, layout: PacketLayout) -> list[str]:
    lines = []
    size = sum(_SIZES[field.kind] for field in layout.scalars)
    if layout.scalars:
        lines.append("typedef struct __attribute__((packed)) {")
        lines += [f"    {_TYPES[field.kind]} {field.name};" for field in layout.scalars]
        lines.append(f"}} message_{name.lower()}_t;")
    lines.append(f"#define {name}_BYTES {size}")
    if layout.scalars:
        lines.append(f'_Static_assert(sizeof(message_{name.lower()}_t) == {name}_BYTES, "packed");')
    for field in layout.tail:
        what = "longest" if field.limit else "each"
        lines.append(f"#define {name}_{field.name.upper()}_BYTES {field.limit or field.size} /* {what} */")
    return [*lines, ""]


def _bytes(name: str, data: bytes) -> list[str]:
    rows = [data[at : at + 16] for at in range(0, len(data), 16)]
    return [
        f"static const uint8_t {name}[] = {{",
        *("    " + " ".join(f"0x{byte:02X}," for byte in row) for row in rows),
        "};",
        "",
    ]


if __name__ == "__main__":
    sys.exit(main())
