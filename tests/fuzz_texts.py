"""Text that `fuzzing` changes: tables of measurements and skins."""

import random
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w
from fuzz_files import COARSE, changed, copied, near
from fuzzing import Kind, spoilt

import ohmskin as ohm
from ohmskin.errors import OhmskinError
from ohmskin.importers import read_recording
from ohmskin.sensing import drive_of, modes
from ohmskin.skin import Skin, VirtualSkin, description, shipped_skins, virtual


class Tables:
    """Text tables: cells, headers, settings, rows and columns changed."""

    allowed = (OhmskinError,)
    _CELLS = (
        "",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-1",
        "0",
        "1.5",
        "0x10",
        "1_000",
        "\uff11",
        "9" * 400,
        '"',
        '"1"',
        "a,b",
        "1e-400",
        "1024",
        "65535",
        "\u2028",
        "\0",
        "1;2",
    )

    def __init__(self, _: Path) -> None:
        rows = [[f"{v:.4g}" for v in row] for row in np.random.default_rng(0).normal(size=(208, 4))]
        pattern = [
            ["source", "sink", "plus", "minus", "current"],
            *([str(k % 6), str((k + 1) % 6), str((k + 2) % 6), str((k + 3) % 6), "1e-3"] for k in range(12)),
        ]
        data = [["reference", "one", "two"], *(["0.1", "0.11", "0.12"] for _ in range(12))]
        self._bases = [rows, [a + b for a, b in zip(pattern, data, strict=True)], data]
        self._pattern = pattern

    def make(self, rng: random.Random) -> bytes:
        which = rng.randrange(3)
        tables = [copied(self._bases[which]), *([copied(self._pattern)] if which == 2 else [])]
        for _ in range(rng.choice((1, 1, 2, 4))):
            table = rng.choice(tables)
            row = rng.randrange(len(table) if rng.random() < 0.5 else min(2, len(table)))
            column = rng.randrange(len(table[row]) or 1)
            match rng.randrange(8):
                case 0:
                    del table[row]
                case 1:
                    table[row] = table[row] * (rng.choice((2, 6000)) if len(table[row]) < 100 else 1)
                case 2:
                    for each in table:
                        del each[column : column + 1]
                case 3:
                    for each in table:
                        each[column:column] = [rng.choice(self._CELLS)]
                case 4:
                    table[row:row] = [
                        [f"# {rng.choice(('first', 'current', 'skin', 'x'))} = {rng.choice(self._CELLS)}"]
                    ]
                case _ if table[row]:
                    table[row][column % len(table[row])] = rng.choice(self._CELLS)
            table[:] = table or [[""]]
        comma, end = rng.choice((",", ",", ",", ";", ", ")), rng.choice(("\n", "\n", "\r\n", "\r"))
        parts = [end.join(comma.join(row) for row in table).encode() for table in tables]
        return b"\n#####\n".join(spoilt(part, rng) if rng.random() < 0.2 else part for part in parts)

    def use(self, content: bytes, rng: random.Random) -> None:
        name = rng.choice(("a.csv", "a_55uA_.csv", "a_1.2.3uA_.csv", "a_" + "9" * 100 + "uA_.csv"))
        own, _, pattern = content.partition(b"\n#####\n")
        Path(name).write_bytes(own)
        beside = Path(name).with_name(Path(name).stem + ".pattern.csv")
        beside.unlink(missing_ok=True)
        if pattern:
            beside.write_bytes(pattern)
        recording = read_recording(name, driven=rng.random() < 0.3)
        assert recording.frames[0].voltages.shape == recording.quiet[0].voltages.shape


class Skins:
    """Skins: entries changed, of another type, out of range, twice or nowhere; every tenth is used, too."""

    allowed = (OhmskinError,)

    def __init__(self, _: Path) -> None:
        VirtualSkin(COARSE, 0).scan(ohm.adjacent([range(12)]))  # what is compiled is compiled now
        mode = ohm.Mode("quick", "tracking", "fit", prior="matern", injections=6, title="Quick")
        calibrated = replace(COARSE, modes=(mode,))
        self._bases = [*(Skin.load(name).dump() for name in shipped_skins()), COARSE.dump(), calibrated.dump()]

    def make(self, rng: random.Random) -> bytes:
        tree = tomllib.loads(rng.choice(self._bases))
        for _ in range(rng.choice((1, 1, 2, 3, 6))):
            tree = changed(tree, rng, near)
        try:
            content = tomli_w.dumps(tree).encode()
        except (ValueError, TypeError):
            return self.make(rng)
        return spoilt(content, rng) if rng.random() < 0.2 else content

    def use(self, content: bytes, rng: random.Random) -> None:
        for cached in (description._transfer_model, description._electrode_model, description._design, virtual._sheet):
            cached.cache_clear()  # the memory of one case is no other's
        Path("case.toml").write_bytes(content)
        skin = Skin.load("case.toml")
        assert Skin.parse(skin.dump()) == skin
        found = modes(skin)
        triangles = 2.31 * skin.domain.area / skin.imaging.mesh_size**2  # finer ones take long by what they say
        if rng.random() < 0.1 and triangles < 10_000:
            skin.transfer_model()
            for mode in found.values():
                drive_of(mode, skin)
            VirtualSkin(skin, 0).scan(drive_of(next(iter(found.values())), skin).next((), 0))


TEXTS: dict[str, Callable[[Path], Kind]] = {"csv": Tables, "toml": Skins}
