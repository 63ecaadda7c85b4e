"""What takes seconds to make is made once on a machine, and never read stale, damaged or from elsewhere."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ohmskin import Skin
from ohmskin.arrays import Floats
from ohmskin.cache import cache_folder, cached
from ohmskin.forward import ContactTable
from ohmskin.geometry import Band, Disc, Domain, Polygon, kept_mesh, mesh_domain
from ohmskin.geometry.holes import Holed

PAPER = Skin.load("paper")
NUMBERS = np.arange(4.0)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OHMSKIN_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


def made(*inputs: "np.ndarray[tuple[int, ...], np.dtype[np.generic]] | float | str | None") -> bool:
    """Whether it was made now, and not read."""
    calls = list[int]()

    def make() -> dict[str, Floats]:
        calls.append(1)
        return {"numbers": NUMBERS}

    assert np.array_equal(cached("numbers", inputs, make)["numbers"], NUMBERS)
    return bool(calls)


def test_it_is_made_once_for_the_same_inputs() -> None:
    assert made(NUMBERS, 1.0, "a", None)
    assert not made(NUMBERS.copy(), 1.0, "a", None)
    others = [
        (NUMBERS + 1e-12, 1.0, "a", None),
        (NUMBERS.reshape(2, 2), 1.0, "a", None),
        (NUMBERS.astype(np.float32), 1.0, "a", None),
        (NUMBERS, np.nextafter(1.0, 2.0), "a", None),
        (NUMBERS, 1.0, "b", None),
        (NUMBERS, 1.0, "a", 0.0),
    ]
    assert all(made(*other) for other in others)


def test_what_is_damaged_or_cut_short_is_made_anew(folder: Path) -> None:
    assert made()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    for content in (b"", whole[:3], whole[:-1], whole[:200] + bytes([whole[200] ^ 1]) + whole[201:]):
        file.write_bytes(content)
        assert made()
        assert not made()


def test_where_nothing_can_be_written_it_is_made_each_time(folder: Path) -> None:
    folder.write_text("a file where the folder would be")
    assert made()
    assert made()


def test_what_was_longest_unused_makes_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        assert made(float(number))
        (newest,) = (file for file in folder.iterdir() if file.stat().st_mtime > 1e6)
        os.utime(newest, (number + 1, number + 1))
    assert not made(0.0)  # used now
    monkeypatch.setattr("ohmskin.cache.ROOM", 3 * newest.stat().st_size)
    assert made(3.0)
    assert not made(0.0)
    assert made(1.0)


def test_what_is_too_large_is_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ohmskin.cache.LARGEST", 10)
    assert made()
    assert made()


def test_tables_that_were_kept_are_those_that_are_made(folder: Path) -> None:
    model = PAPER.electrode_model()
    first, second = (ContactTable.kept(model, 8e-3, 4e-3) for _ in range(2))
    assert len(list(folder.glob("contacts-*"))) == 1
    anew = ContactTable(model, 8e-3, 4e-3)
    for table in (first, second):
        assert table.pairs is model.pairs
        for one, other in zip(table.content, anew.content, strict=True):
            np.testing.assert_array_equal(one, other)
    harder = model.with_conductivity(2 * model.conductivity)
    assert not np.array_equal(ContactTable.kept(harder, 8e-3, 4e-3).content[0], anew.content[0])


def test_meshes_that_were_kept_are_those_that_are_made(folder: Path) -> None:
    square, corner = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)], np.array([[0.05, 0.0]])
    domains: list[Domain] = [
        Polygon(square),
        Polygon([*square[:3], (1e-9, 0.1)]),
        Polygon(square, [[(0.03, 0.03), (0.07, 0.03), (0.07, 0.07)]]),
        Holed(Polygon(square), [[(0.03, 0.03), (0.07, 0.03), (0.07, 0.06)]]),
        Disc(0.05),
        Band(0.1, 0.1),
    ]
    for number, domain in enumerate(domains, 1):
        points = corner if isinstance(domain, Polygon | Holed) else np.empty((0, 2))
        anew = mesh_domain(domain, 8e-3, points, closest=0.05)
        for mesh in (kept_mesh(domain, 8e-3, points, 0.05) for _ in range(2)):
            np.testing.assert_array_equal(mesh.nodes, anew.nodes)
            np.testing.assert_array_equal(mesh.elements, anew.elements)
            assert mesh.period == anew.period
        assert len(list(folder.iterdir())) == number
    for size, points, closest in ((7e-3, corner, 0.05), (8e-3, corner * 1.02, 0.05), (8e-3, corner, 0.06)):
        kept_mesh(domains[0], size, points, closest)
    assert len(list(folder.iterdir())) == len(domains) + 3


def test_another_process_reads_what_one_has_made(folder: Path) -> None:
    drive = "PositionDrive(PAPER.electrodes, PAPER.design, 16, numbers).ranking"
    code = f"""if True:
        import numpy as np
        from ohmskin import Skin
        from ohmskin.drive import PositionDrive, base_pattern
        import ohmskin.forward.response, ohmskin.drive.position as position
        PAPER = Skin.load("paper")
        numbers = base_pattern(PAPER.electrodes).injections
        ranking = {drive}
        print(ranking.order.sum(), float(ranking.values.sum()).hex())
        """
    told, files = list[str](), list[dict[str, int]]()
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        told.append(done.stdout)
        files.append({file.name: file.stat().st_ino for file in folder.iterdir()})
    assert told[0] == told[1] != ""
    assert {name.split("-")[0] for name in files[0]} == {"contacts", "mesh", "ranking"}
    assert files[0] == files[1]  # nothing was written again


def test_the_folder_is_the_users_unless_another_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder().name == "kept"
    monkeypatch.delenv("OHMSKIN_CACHE")
    assert cache_folder().name == "ohmskin"
