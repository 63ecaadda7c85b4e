"""What is compiled once on a machine is told while that goes on."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numba.core import event
from numba.core.dispatcher import Dispatcher
from waiting import until

import ohmskin
from ohmskin.compiler import Interpreted, compiling
from ohmskin.contacts import refit, solution
from ohmskin.engine.functions import INTERPRETED

LOOP = """if True:
    from direct import DirectDevice
    from ohmskin import Engine, Skin, VirtualSkin
    skin, told = Skin.parse("[imaging]\\nmesh_size = 9e-3\\n"), []
    with Engine(lambda: DirectDevice(VirtualSkin(skin)), skin, "12B") as engine:
        engine.calibrate(lambda _: told.append(engine.message))
        print(*told, sep="\\n")
        print("then", repr(engine.message))
    """
TOUCHED = """if True:
    import sys
    from direct import DirectDevice
    from numba.core.dispatcher import Dispatcher
    from ohmskin import Engine, Skin, VirtualSkin
    from ohmskin.engine.compiling import compile_ahead
    from ohmskin.compiler import take_turns

    take_turns()

    def compiled():
        modules = [module for name, module in list(sys.modules.items()) if name.startswith("ohmskin")]
        parts = [part for module in modules for part in vars(module).values() if isinstance(part, Dispatcher)]
        return {str((part, one)) for part in parts for one in part.signatures}

    skin = Skin.parse("")
    virtual = VirtualSkin(skin)
    compile_ahead(lambda *_: None)
    ahead = compiled()
    with Engine(lambda: DirectDevice(virtual), skin, sys.argv[1]) as engine:
        engine.calibrate()
        before = compiled()
        virtual.press(1, 0.06, 0.14, 0.01, 8e3)
        virtual.press(2, 0.14, 0.05, 0.01, 8e3)
        print(*[len(engine.step().contacts) for _ in range(6)])
        print(len(compiled() - before), *sorted(compiled() - before))
        print(len(before - ahead), *sorted(before - ahead))
    """
COMMAND = """if True:
    import sys
    from ohmskin.cli import main
    sys.argv = ["ohmskin", "live", "--json", "--mode", "12B", "--seconds", "0.1"]
    main()
    """


def run(script: str, *arguments: str, cache: Path | None = None) -> "subprocess.CompletedProcess[str]":
    folders = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "PYTHONPATH": folders} | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})
    command = [sys.executable, "-c", script, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)


@pytest.fixture
def partly(tmp_path: Path) -> Path:
    """A folder of compiled functions, but for those of one package that every loop calls."""
    return without("inverse_*", tmp_path / "numba")


def without(functions: str, kept: Path) -> Path:
    """A folder of compiled functions, but for some."""
    if (ours := Path(os.environ["NUMBA_CACHE_DIR"])).exists():
        shutil.copytree(ours, kept, ignore=shutil.ignore_patterns("*.tmp.*", functions))
    return kept


def test_the_skin_is_felt_while_the_default_mode_is_compiled_which_follows_by_itself(tmp_path: Path) -> None:
    run(TOUCHED, "16P")  # compiles what is missed by nobody below
    kept = without("*refit*", tmp_path / "numba")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kept)}
    modes, said = list[str](), list[str]()
    command = [sys.executable, "-m", "ohmskin", "live", "--json", "--seconds", "300"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            touch = json.loads(line)
            said += touch["messages"]
            modes += [touch["mode"]] if touch["state"] == "running" and touch["mode"] not in modes else []
            if "16P" in modes:
                process.send_signal(signal.SIGINT)
    assert modes == ["16O", "16P"]
    assert any(one.startswith("compiling, once on this machine; Adaptive, as in the paper (16O) until") for one in said)
    assert "Adaptive, most precise (16P) from here on" in said
    second = run(COMMAND.replace('"--mode", "12B", ', ""), cache=kept)
    assert "compiling" not in second.stdout + second.stderr
    assert json.loads(second.stdout.splitlines()[-1])["mode"] == "16P"


@pytest.mark.parametrize("mode", ["16P", "16T", "16O", "12B"])
def test_nothing_is_left_to_compile_at_the_first_touch(mode: str) -> None:
    contacts, left, unknown = run(TOUCHED, mode).stdout.splitlines()
    assert contacts.endswith("2")
    assert left == "0"
    if mode == "16P":
        assert unknown == "0", "make ohmskin.engine.signatures anew: .venv/bin/python tools/signatures.py"


def test_a_command_says_so_on_its_first_call_and_only_then(partly: Path) -> None:
    first, second = run(COMMAND, cache=partly), run(COMMAND, cache=partly)
    assert "compiling, once on this machine" in first.stderr
    assert "compiling" not in second.stderr


def test_a_loop_has_it_as_its_message_while_it_lasts(partly: Path) -> None:
    *told, then = run(LOOP, cache=partly).stdout.splitlines()
    assert any(line.startswith("compiling, once on this machine") for line in told)
    assert then == "then ''"


def test_nothing_is_left_to_compile_in_the_mode_that_stands_in_while_the_default_one_is_compiled() -> None:
    script = TOUCHED.replace("*_: None)", "*_: None, Part.STANDING_IN)").replace("import sys", "import sys, types", 1)
    script = script.replace("sys.argv[1]", "compilation=types.SimpleNamespace(under_way=True)")
    script = script.replace(
        "    take_turns()",
        "    from ohmskin.compiler import Interpreted\n"
        "    from ohmskin.engine.functions import INTERPRETED, Part\n"
        "    from ohmskin.forward import assembly\n\n"
        "    take_turns()\n"
        "    assembly._uncompiled, assembly._is_compiled = 1, lambda: False\n"
        "    interpreted = Interpreted(INTERPRETED)",
    )
    contacts, left, unknown = run(script).stdout.splitlines()
    assert contacts.endswith("2")
    assert (left, unknown) == ("0", "0")


def test_what_is_interpreted_for_a_while_no_other_compiled_function_calls() -> None:
    package = Path(ohmskin.__file__).parent
    files = [file.relative_to(package.parent) for file in package.rglob("*.py") if "@njit" in file.read_text()]
    modules = [import_module(".".join(file.with_suffix("").parts)) for file in files]
    functions = {part for module in modules for part in vars(module).values() if isinstance(part, Dispatcher)}
    assert len(functions) > 100
    for function in (one for one in functions if one.__module__ not in INTERPRETED):
        plain = function.py_func
        called = [plain.__globals__.get(name) for name in plain.__code__.co_names]
        names = {one.__module__ for one in called if isinstance(one, Dispatcher)}
        names |= {one.__name__ for one in called if isinstance(one, ModuleType)}
        assert not names & {*INTERPRETED}, function


def test_what_is_interpreted_for_a_while_is_so_wherever_it_is_known_and_gives_the_same() -> None:
    compiled, matrix = solution.inverse, np.array([[2.0, 1.0], [1.0, 3.0]])
    with Interpreted([solution.__name__]):
        assert solution.inverse is refit.inverse is compiled.py_func
        np.testing.assert_allclose(solution.inverse(matrix), np.linalg.inv(matrix), rtol=1e-12)
    assert solution.inverse is refit.inverse is compiled


def test_what_one_process_compiles_no_other_one_does(tmp_path: Path) -> None:
    script = """if True:
        import sys
        from ohmskin.cli import _compiling
        from ohmskin.geometry.overlap import _edge

        _compiling()  # as every command that has something to compile
        print("ready", flush=True)
        sys.stdin.readline()
        _edge.compile("(f8, f8, f8, f8, f8)")
        print(sum(_edge.stats.cache_misses.values()), sum(_edge.stats.cache_hits.values()))
        """
    command, settings = [sys.executable, "-c", script], os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    pipes = dict.fromkeys(("stdin", "stdout"), subprocess.PIPE)
    both = [subprocess.Popen(command, env=settings, text=True, **pipes) for _ in range(2)]
    assert [process.stdout.readline() for process in both] == ["ready\n"] * 2
    for process in both:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert sorted(process.communicate(timeout=120)[0] for process in both) == ["0 1\n", "1 0\n"]


def test_a_sign_of_life_comes_while_one_function_takes_long() -> None:
    told: list[str] = []
    slow = {"dispatcher": SimpleNamespace(py_func=compiling)}  # stands in for a function of ours
    with compiling(told.append):
        event.start_event("numba:compile", data=slow)
        until(lambda: len(told) == 2, 30)
        event.end_event("numba:compile", data=slow)
    assert told[0] == "compiling, once on this machine"
    assert re.fullmatch(r"compiling, once on this machine; 1 function in \d+ s", told[1])
