"""What is compiled once on a machine is told while that goes on."""

import os
import subprocess
import sys
from pathlib import Path

LOOP = """if True:
    from direct import DirectDevice
    from ohmskin import Engine, Skin, VirtualSkin
    skin, told = Skin.parse("[imaging]\\nmesh_size = 9e-3\\n"), []
    with Engine(lambda: DirectDevice(VirtualSkin(skin)), skin, "12B") as engine:
        engine.calibrate(lambda _: told.append(engine.message))
        print(*told, sep="\\n")
        print("then", repr(engine.message))
    """
COMMAND = """if True:
    import sys
    from ohmskin.cli import main
    sys.argv = ["ohmskin", "live", "--json", "--mode", "12B", "--seconds", "0.1"]
    main()
    """


def run(script: str, cache: Path) -> "subprocess.CompletedProcess[str]":
    folders = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": folders}
    return subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)


def test_a_command_says_so_on_its_first_call_and_only_then(tmp_path: Path) -> None:
    first, second = run(COMMAND, tmp_path), run(COMMAND, tmp_path)
    assert "compiling, once on this machine" in first.stderr
    assert "compiling" not in second.stderr


def test_a_loop_has_it_as_its_message_while_it_lasts(tmp_path: Path) -> None:
    *told, then = run(LOOP, tmp_path).stdout.splitlines()
    assert any(line.startswith("compiling, once on this machine") for line in told)
    assert then == "then ''"
