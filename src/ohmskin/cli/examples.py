"""``ohmskin examples``: small recordings to try the other commands on."""

from importlib import resources
from pathlib import Path

from ohmskin.cli.options import make_folder

_USES = {"touch.mcap": "replay", "touch.csv": "image"}


def examples(folder: Path = Path("recordings"), /) -> None:
    """Write two small recordings of the virtual skin: a session (.mcap), and a table as other instruments write (.csv).

    Args:
        folder: Folder to write to; created if it does not exist. Existing files are kept.
    """
    make_folder(folder)
    for name, use in _USES.items():
        if not (target := folder / name).exists():
            target.write_bytes((resources.files("ohmskin.recording") / "examples" / name).read_bytes())
        print(f"{target}; try: ohmskin {use} {target}")
