"""The public face of the package."""

import ast
import importlib
import importlib.util
import os
import pkgutil
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from email import message_from_bytes
from email.message import Message
from pathlib import Path

import pytest

import ohmskin

ROOT = Path(__file__).parents[1]


def test_everything_public_is_there_and_lazily_so() -> None:
    for name in ohmskin.__all__:
        assert getattr(ohmskin, name) is not None
    assert set(ohmskin.__all__) == set(ohmskin._HOMES)


def test_editors_are_told_of_all_that_is_public() -> None:
    tree = ast.parse(Path(ohmskin.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    told = {alias.name: node.module for node in imports for alias in node.names}
    assert told == {name: f"ohmskin.{home}" for name, home in ohmskin._HOMES.items()}


def test_every_package_exports_what_it_names() -> None:
    for module in pkgutil.iter_modules(ohmskin.__path__, "ohmskin."):
        if module.name != "ohmskin.__main__":
            package = importlib.import_module(module.name)
            for name in getattr(package, "__all__", []):
                assert hasattr(package, name), f"{module.name}.{name}"


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("ohmskin", "numpy scipy numba matplotlib starlette"),
        ("ohmskin.mcap.process", "numpy scipy numba"),  # the recorder's process
        ("ohmskin.outlets.process", "numba ohmskin.geometry ohmskin.contacts"),  # the publishing process
        ("ohmskin.view.server", "scipy numba"),
        ("ohmskin.cli.serve; ohmskin.cli._compiling()", "ohmskin.sensing ohmskin.recording scipy.optimize"),
        ("ohmskin.engine, ohmskin.device.virtual", "scipy.integrate scipy.interpolate scipy.ndimage scipy.stats mcap"),
    ],
)
def test_a_process_imports_nothing_heavy_that_it_does_without(modules: str, heavy: str) -> None:
    """Each takes up to a second, at every start."""
    code = f"import sys, {modules}; print([m for m in {heavy.split()} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, atexit\n"
        "atexit.register(lambda: print([m for m in ('numpy', 'scipy', 'numba', 'matplotlib') if m in sys.modules]))\n"
        "sys.argv = ['ohmskin', '--help']\nimport ohmskin.cli; ohmskin.cli.main()"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip().endswith("[]")


def test_without_matplotlib_pictures_say_what_to_install_before_anything_is_done(tmp_path: Path) -> None:
    commands = (
        "image a.csv",
        "layout",
        "pattern",
        "export a.mcap --to mp4",
        "replay a.mcap --compare paper",
        "self-test --output .",
        "calibrate --picture a.png",
        "learn a.csv --picture a.png",
        "policies --quick",
        "reproduce --quick",
        "bench --quick",
    )
    (tmp_path / "a.mcap").touch()
    code = "import sys; sys.modules['matplotlib'] = None; from command_line import ohmskin\n"  # as if it were not there
    code += (
        "for told in map(str.split, sys.argv[1:]): done = ohmskin(*told); print(done.returncode, done.stderr, end='')"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests")}
    command = [sys.executable, "-c", code, *commands]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment, timeout=300)
    told = "2 ohmskin: pictures need Matplotlib; install it: pip install 'ohmskin[plot]'"
    assert ran.stdout.splitlines() == [told] * len(commands), ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


# --- what is built ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, its wheel, and the wheel of the client."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    for place, what in ((ROOT, ("sdist", "wheel")), (ROOT / "packaging" / "client", ("wheel",))):
        for target in what:
            command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
            subprocess.run(command, cwd=place, check=True, capture_output=True, timeout=300)
    return folder


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


def test_wheel_and_sdist_have_all_that_is_needed(built: Path) -> None:
    (wheel,), (sdist,) = built.glob("ohmskin-*.whl"), built.glob("ohmskin-*.tar.gz")
    source = {str(path.relative_to(ROOT / "src")) for path in (ROOT / "src").rglob("*") if path.is_file()}
    wanted = {name for name in source if "__pycache__" not in name and ".egg-info" not in name}
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    assert wanted <= packed
    assert "ohmskin/py.typed" in packed
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "CHANGELOG.md"} <= names
    assert {"ros/ohmskin_msgs/package.xml", "packaging/client/pyproject.toml"} <= names
    told = metadata(wheel)
    assert told["Version"] == ohmskin.__version__
    assert told["Description-Content-Type"] == "text/markdown"
    assert "Typing :: Typed" in told.get_all("Classifier", [])


RELEASE = ohmskin.__version__.removesuffix(".dev0")  # package.xml takes three numbers only


def test_everything_tells_the_same_version(built: Path) -> None:
    def told(file: str, pattern: str) -> str:
        return re.findall(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)[0]

    (client,) = built.glob("ohmskin_client-*.whl")
    assert metadata(client)["Version"] == told("CITATION.cff", r"^version: (\S+)") == ohmskin.__version__
    assert told("CHANGELOG.md", r"^## (.*)") == f"{RELEASE} (unreleased)" or ohmskin.__version__ == RELEASE
    for package in ("ohmskin_msgs", "ohmskin_ros"):
        assert told(f"ros/{package}/package.xml", r"<version>(\S+)</version>") == RELEASE


def test_the_readme_of_an_index_leads_nowhere_that_is_not_there(built: Path) -> None:
    (wheel,) = built.glob("ohmskin-*.whl")
    text = str(metadata(wheel).get_payload())
    repository = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["metadata"]
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert all(link.startswith(("https://", "http://", "#")) for link in links)
    assert bool(links) or not repository["hooks"]["custom"]["repository"]
    assert "# ohmskin" in text


def test_a_repository_makes_links_absolute() -> None:
    pytest.importorskip("hatchling")
    described = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert described is not None
    assert described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    text = "![a](docs/a.png) [b](docs/b.md#c) [d](https://d.example/e) [f](#g)"
    there = "https://code.example/us/ohmskin"
    kept = "[d](https://d.example/e) [f](#g)"
    assert module.readme(text, there) == f"![a]({there}/raw/main/docs/a.png) [b]({there}/blob/main/docs/b.md#c) {kept}"
    assert module.readme(text, "") == f" b {kept}"


def test_the_client_can_be_installed_alone(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("ohmskin_client-*.whl")
    assert wheel.stat().st_size < 1e5
    assert not [need for need in metadata(wheel).get_all("Requires-Dist", []) if "extra ==" not in need]
    venv.create(tmp_path / "alone")
    python = tmp_path / "alone" / "bin" / "python"
    home = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    )
    zipfile.ZipFile(wheel).extractall(home.stdout.strip())
    code = "import sys\nfrom ohmskin.client import Client, Board\nwith Client() as skin: print(skin.newest())\n"
    code += "import ohmskin.client.remote\nprint(ohmskin.client.__file__)\n"
    code += "print(sorted(sys.modules.keys() & {'numpy', 'ohmskin.skin'}))"
    environment = {"OHMSKIN_BOARDS": str(tmp_path / "boards"), "PATH": "/usr/bin:/bin"}
    ran = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, env=environment, timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines()[0] == "None"
    assert str(tmp_path) in ran.stdout
    assert ran.stdout.rstrip().endswith("[]")
