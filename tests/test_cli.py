"""The command line as a user types it."""

import ctypes
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import command_line
import numpy as np
import pytest
from live_process import all_gone, children, live, serving
from waiting import until

from ohmskin.cli import app, main
from ohmskin.cli.heartbeat import HEARTBEAT
from ohmskin.cli.options import Stop
from ohmskin.errors import ModelError

Running = Callable[[Callable[[], None]], None]


def ohmskin(*arguments: str, cwd: Path | None = None, timeout: float = 300) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "ohmskin", *arguments], capture_output=True, text=True, cwd=cwd, timeout=timeout
    )


BODY = "examples/humanoid/body.toml"
TOUCH = __file__  # a file that is there
NOBODY = "tcp://127.0.0.1:1"  # a device that would be missed if it were asked for first


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["live", "--skin", "nosuch"], "no skin named 'nosuch'; give a .toml file or one of dome, ktc2023, paper"),
        (["live", "--device", "tcp://127.0.0.1:1"], "serve-skin"),
        (["live", "--device", "nosuch:1"], "no driver for 'nosuch:1'"),
        (["scan", "--device", "virtual"], "no driver for 'virtual'; an address begins with one of"),
        (["press", "50", "120", "--device", "virtual"], "no driver for 'virtual'; an address begins with one of"),
        (["live", "--mode", "99Z", "--headless"], "'99Z' is not possible"),
        (["live", "--seconds", "-1"], "must be positive"),
        (["live", "--estimator", "nosuch"], "no estimator 'nosuch'; choose from gauss-newton, positive, kalman"),
        (["record", "x.mcap", "--prior", "nosuch"], "no prior 'nosuch'; choose from paper, laplacian"),
        (["replay", "nosuch.mcap", "--rule", "nosuch"], "no rule 'nosuch'; choose from physical, noise figure"),
        (["live", "--device", "replay:nosuch.csv"], "there is no file nosuch.csv; `ohmskin examples` writes two"),
        (["live", "--mode", "99Z"], "'99Z' is not possible"),
        (["export", "nosuch.mcap", "--to", "csv"], "there is no file nosuch.mcap"),
        (["live", "--device", NOBODY, "--name", "arm"], "--name has no effect without --publish; leave it out"),
        (["live", "--device", NOBODY, "--json", "--port", "9000"], "--port has no effect with --json; leave it out"),
        (
            ["live", "--device", NOBODY, "--estimator", "absolute", "--prior", "pixels"],
            "'absolute' makes no image of pix",
        ),
        (["live", "--device", NOBODY, "--estimator", "greit", "--prior", "matern"], "'greit' has its own prior"),
        (["replay", TOUCH, "--compare", "paper", "--speed", "2"], "--speed has no effect with --compare; leave it out"),
        (["patches", BODY, "--joint-topic", "/x"], "--joint-topic has no effect without --joints; leave it out"),
        (["robot", "--mode", "99Z"], "mode '99Z' is not possible with this skin; choose from 12B"),
        (["robot", "--picture", "arm.jpg"], "--picture is arm.jpg; give a name that ends with .png"),
        (["live", "--host", "0.0.0.0"], "token"),
        (["live", "--device", NOBODY, "--host", "0.0.0.0"], "give a token"),
        (["live", "--device", NOBODY, "--host", "192.0.2.1", "--token", "12345678"], "cannot listen on 192.0.2.1"),
        (["live", "--device", NOBODY, "--port", "70000"], "choose 1 to 65535"),
        (["live", "--device", NOBODY, "--publish", "smoke"], "choose from shm, zenoh, dds, foxglove"),
        (["live", "--device", NOBODY, "--publish", "zenoh:udp/x"], "zenoh:udp/x is not a place; use zenoh, zenoh:tcp/"),
        (["live", "--device", NOBODY, "--publish", "mcap:nosuch/x.mcap"], "create it first"),
        (["live", "--device", NOBODY, "--publish", "shm", "--name", "a/b"], "'a/b' cannot name what a skin publishes"),
        (["live", "--device", NOBODY, "--record", "touch.csv"], "recordings are MCAP files; record to touch.mcap"),
        (["record", "touch.csv", "--device", NOBODY], "recordings are MCAP files; record to touch.mcap"),
        (["calibrate", "--picture", "x.doc", "--device", NOBODY], "'.doc' is not a picture format; choose .png"),
        (["layout", "--output", "x.doc"], "'.doc' is not a picture format"),
        (["image", "nosuch.csv", "--output", "nosuch/x.png"], "cannot write nosuch/x.png"),
        (["press", "50", "120", "--device", "virtual:"], "run `ohmskin serve-skin` and press that one"),
        (["lve"], "no command 'lve'; did you mean live?"),
        (["frobnicate"], "`ohmskin --help` lists"),
        (["live", "--prt", "1"], "Did you mean"),
        (["record"], "requires an argument"),
        (["press", "50", "120", "--device", "tcp://127.0.0.1:1"], "serve-skin"),
        (["serve-skin", "--skin", "nosuch.toml"], "cannot read skin file nosuch.toml"),
    ],
)
def test_a_mistake_gets_one_clear_line_and_no_traceback(arguments: list[str], says: str) -> None:
    refused = command_line.ohmskin(*arguments)
    is_one_line(refused, says)
    if "tcp://127.0.0.1:1" not in arguments:  # which only who connects knows
        assert "open http" not in refused.stdout, "a page was opened that is good for nothing"


def test_a_wrong_part_of_a_mode_is_told_before_a_device_is_opened(tmp_path: Path) -> None:
    (skin := tmp_path / "mine.toml").write_text('[modes.mine]\ndrive = "rim"\nreader = "nosuch"')
    refused = command_line.ohmskin("live", "--device", NOBODY, "--skin", str(skin), "--mode", "mine")
    is_one_line(refused, "no reader 'nosuch'; choose from centroid, fit")


def test_a_mistake_gets_one_clear_line_in_a_process_of_its_own() -> None:
    is_one_line(ohmskin("image", "nosuch.csv"), "there is no file nosuch.csv")


def is_one_line(result: "subprocess.CompletedProcess[str]", says: str) -> None:
    assert result.returncode == 2
    assert says in result.stderr
    assert "Traceback" not in result.stderr
    assert len(re.sub("^[.]+\n", "", result.stderr, flags=re.MULTILINE).strip().splitlines()) == 1


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_every_command_has_help_with_an_example(command: str) -> None:
    result = command_line.ohmskin(command, "--help")
    assert result.returncode == 0
    assert f"ohmskin {command}" in result.stdout
    assert "Example" in result.stdout or command == "info"


OPTIONAL = ("mujoco", "zarr", "pyarrow", "zenoh", "cyclonedds", "foxglove", "pyeit", "distributed", "gmsh", "meshio")


def test_help_and_suggestions_need_no_extra() -> None:
    script = f"""if True:
        import sys
        from importlib.abc import MetaPathFinder

        class Missing(MetaPathFinder):
            def find_spec(self, name, path, target=None):
                if name.partition(".")[0] in {OPTIONAL}:
                    raise ModuleNotFoundError(name)

        sys.meta_path.insert(0, Missing())
        from command_line import ohmskin
        from ohmskin.cli import app
        for name in (name for name in app if not name.startswith("-")):
            found = ohmskin(name, "--help")
            assert found.returncode == 0, (name, found.stderr)
        assert "did you mean robot" in ohmskin("robt").stderr
        """
    folder = str(Path(__file__).parent)
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=folder, timeout=300)
    assert result.returncode == 0, result.stderr


def test_a_mistyped_command_imports_none() -> None:
    script = "from command_line import ohmskin, sys; ohmskin('lve'); print(*(m for m in sys.modules if 'cli.' in m))"
    folder = str(Path(__file__).parent)
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=folder, timeout=300)
    assert (result.stdout.strip(), result.stderr) == ("ohmskin.cli.heartbeat", "")


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_every_option_has_help_and_no_needless_twin(command: str) -> None:
    found = command_line.ohmskin(command, "--help").stdout
    assert "--empty" not in found
    assert '""' not in found.replace('"best"', "")
    for argument in app[command].assemble_argument_collection(parse_docstring=True):
        if argument.parse and argument.parameter.show is not False and not argument.children:
            assert argument.parameter.help, argument.name
        if argument.field_info.default is False:
            assert f"--no-{argument.name.lstrip('-')}" not in found


def test_every_part_of_a_study_stands_in_its_help() -> None:
    """What --only takes: the refusal of another name lists the parts."""
    for command in ("reproduce", "policies", "bench"):
        refused = command_line.ohmskin(command, "--only", "nosuch")
        parts = re.findall(r"\w+", refused.stderr.rpartition("choose from ")[2])
        told = command_line.ohmskin(command, "--help").stdout.partition("--only")[2].partition("--")[0]
        assert len(parts) > 8
        assert re.findall(r"\w+", told.partition(":")[2].partition(".")[0]) == parts


def test_commands_come_in_groups() -> None:
    found = command_line.ohmskin("--help").stdout
    panels = re.findall(r"╭─ (.+?) ─+╮", found)
    assert panels == ["Sense", "Recordings", "Build a skin", "Virtual skin", "Studies", "Options"]
    assert "Exit status: 0 done, 1 " in found
    assert found.index(" live ") < found.index("╭─ Recordings") < found.index(" replay ")


def test_the_former_name_of_output_still_works() -> None:
    assert "output folder /dev/null/x" in command_line.ohmskin("policies", "--quick", "--out", "/dev/null/x").stderr
    assert "output folder /dev/null/x" in command_line.ohmskin("policies", "--quick", "--out=/dev/null/x").stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_installs(shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    found = command_line.ohmskin("--install-completion", "--shell", shell)
    assert found.returncode == 0, found.stderr
    (file,) = (path for path in tmp_path.rglob("*ohmskin*") if path.is_file())
    assert shell in str(file)
    assert all(word in file.read_text(encoding="utf-8") for word in ("calibrate", "serve-skin", "estimator"))
    asking = {
        "bash": f"source {file}; COMP_WORDS=(ohmskin cal); COMP_CWORD=1; _ohmskin; echo ${{COMPREPLY[@]}}",
        "fish": f"source {file}; complete -C 'ohmskin cal'",
    }
    if shell in asking and shutil.which(shell):
        done = subprocess.run([shell, "-c", asking[shell]], capture_output=True, text=True, check=True)
        assert re.split(r"\s", done.stdout)[0] == "calibrate"


def test_a_command_that_takes_long_to_import_shows_signs_of_life_in_a_pipe_too() -> None:
    script = """if True:
        import sys, time
        from importlib.abc import MetaPathFinder

        class Slow(MetaPathFinder):
            def find_spec(self, name, path, target=None):
                time.sleep(2.5 if name == "ohmskin.cli.examples" else 0)

        sys.meta_path.insert(0, Slow())
        sys.argv = ["ohmskin", "examples", "--help"]
        from ohmskin.cli import main
        main()
        """
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert re.fullmatch("[.]+\n", result.stderr)
    assert "Usage" in result.stdout


def test_signs_of_life_come_in_silence_alone_and_on_a_line_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ohmskin.cli.heartbeat._EVERY", 0.2)
    said: list[str] = []

    def silence(seconds: float) -> None:
        time.sleep(seconds)
        said.append(capsys.readouterr().err)

    with HEARTBEAT:
        times = [time.monotonic()]
        while times[-1] < times[0] + 1.0:
            print("busy", file=sys.stderr)
            time.sleep(0.02)
            times.append(time.monotonic())
        silence(0.0)
        silence(1.0)
        print("phase")
        silence(0.0)
        HEARTBEAT.end()
        silence(0.6)
    busy, silent, between, after = said
    assert "." not in busy or max(np.diff(times)) > 0.15  # on a machine that is busier still
    assert re.fullmatch("[.]+", silent)
    assert between == "\n"
    assert after == ""


def test_ctrl_c_while_it_imports_says_nothing() -> None:
    command = [sys.executable, "-X", "importtime", "-m", "ohmskin", "image", "nosuch.csv"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if "numpy" in line:
                break
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
    assert process.returncode == 130
    assert "Traceback" not in rest


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:
    """Makes a function a command, which `main` runs."""

    def command(compute: Callable[[], None]) -> None:
        app.command(compute, name="compute")
        monkeypatch.setattr(sys, "argv", ["ohmskin", "compute"])
        monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)

    yield command
    del app["compute"]


@pytest.mark.parametrize("kinds", [(SystemError, SystemError), (ImportError, ImportError), (ModelError, ImportError)])
def test_ctrl_c_within_c_code_is_ctrl_c_and_other_errors_of_it_are_not_hidden(
    kinds: tuple[type[Exception], type[Exception]], running: Running, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of an interrupt Numba's callbacks make a `SystemError` caused by it, pybind11's modules an `ImportError`."""
    kind, inner_kind = kinds
    inner = inner_kind("initialization failed")
    inner.__cause__ = KeyboardInterrupt()
    outer, other = kind("MuJoCo is missing"), kind("of another cause")
    outer.__cause__ = inner
    other.__cause__ = inner_kind("no such file")
    raised = iter([outer, other])

    def compute() -> None:
        raise next(raised)

    running(compute)
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 130
    assert capsys.readouterr().err == ""
    told = kind is ModelError
    with pytest.raises(SystemExit if told else kind, match="2" if told else "of another cause"):
        main()
    assert capsys.readouterr().err == told * "ohmskin: of another cause\n"


def test_an_error_without_a_cause_after_ctrl_c_is_ctrl_c(running: Running, capsys: pytest.CaptureFixture[str]) -> None:
    """Of an interrupt ctypes makes an `ArgumentError`, told from others by its text alone."""
    pressed = iter([True, False])

    def compute() -> None:
        try:
            if next(pressed):
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            pass
        raise ctypes.ArgumentError("argument 1")

    running(compute)
    with pytest.raises(SystemExit, match="130"):
        main()
    assert capsys.readouterr().err == ""
    with pytest.raises(ctypes.ArgumentError):
        main()


def test_ctrl_c_in_a_destructor_ends_the_command(running: Running, capsys: pytest.CaptureFixture[str]) -> None:
    """What a destructor raises is swallowed, and so is what the hook raises that is told of it."""

    class Deleted:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    def compute() -> None:
        Deleted()
        time.sleep(60.0)

    running(compute)
    with pytest.raises(SystemExit, match="130"):
        main()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_loop_ends_though_something_swallowed_what_was_to_end_it_before_it_began(number: signal.Signals) -> None:
    before = [(each, signal.getsignal(each)) for each in (signal.SIGINT, signal.SIGTERM)]
    hook = sys.unraisablehook
    try:
        stop = Stop()
        with pytest.raises((KeyboardInterrupt, SystemExit)):
            signal.raise_signal(number)
        stop.listen(silent=False)
        assert stop
    finally:
        sys.unraisablehook = hook
        for each, handler in before:
            signal.signal(each, handler)


def test_ctrl_c_while_it_calibrates_ends_it_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ohmskin", "record", "touch.mcap", "--seconds", "60"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        process.stdout.readline()  # calibrating
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=300)
    assert process.returncode == 130
    assert re.sub("[.]+\n|compiling, once.*\n", "", err) == ""
    assert "recording to" not in out


def test_a_command_leaves_signals_as_they_were() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    command_line.ohmskin("live", "--device", NOBODY, "--headless")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_headless_json_is_a_line_per_frame_with_the_press_in_it() -> None:
    with serving("--seed", "1") as (address, _):
        command = [sys.executable, "-m", "ohmskin", "live", "--json", "--mode", "16P", "--device", address]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as sensed:
            assert sensed.stdout is not None
            try:
                frames = [json.loads(sensed.stdout.readline())]
                while frames[-1]["state"] == "calibrating":
                    frames.append(json.loads(sensed.stdout.readline()))
                rest: list[str] = []  # read while it runs: a full pipe would stop the loop before the press ends
                reader = threading.Thread(target=rest.extend, args=(sensed.stdout,))
                reader.start()
                pressed = command_line.ohmskin("press", "60", "140", "--seconds", "1.5", "--device", address)
                told = len(rest)  # of frames of before the finger was lifted, perhaps
                until(lambda: any(not json.loads(line)["contacts"] for line in rest[told:]))
            finally:
                sensed.terminate()
            reader.join()
            frames += [json.loads(line) for line in rest]
        assert sensed.returncode == 0
    assert (pressed.returncode, re.sub("^[.]+\n", "", pressed.stderr)) == (0, "")
    assert (frames[0]["state"], frames[0]["sequence"]) == ("calibrating", None)
    assert "calibrating: keep the skin untouched" in frames[0]["messages"][-1]
    frames = [frame for frame in frames if frame["state"] == "running"]
    assert frames[0]["mode"] == "16P"
    assert frames[0]["contacts"] == []
    places = [contact["position"] for frame in frames for contact in frame["contacts"]]
    assert places
    misses = np.linalg.norm(np.array(places) - [0.06, 0.14], axis=1)
    # the very last frame may be off: a finger lifted between the two scans of a cycle makes them contradict each other
    assert misses[:-1].max() < 12e-3
    assert not frames[-1]["contacts"]
    numbers = [frame["sequence"] for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_info_lists_what_can_be_chosen() -> None:
    result = command_line.ohmskin("info")
    assert result.returncode == 0
    told = [line.split(maxsplit=1) for line in result.stdout.replace("*", " ").splitlines() if line.strip()]
    for name, title in (
        ("16O", "Adaptive, as in the paper"),
        ("rotating", "A few injections a frame in a fixed round of opposite electrodes"),
        ("fit", "Contacts fitted to the data of each frame"),
        ("kalman", "Kalman filter on images"),
        ("paper,", "laplacian, tikhonov, noser, matern"),
        ("physical,", "noise figure, cross-validation, l-curve, discrepancy, evidence"),
    ):
        assert [name, title] in told


def test_headless_table_over_a_pseudo_terminal() -> None:
    with serving("--pty") as (address, _):
        assert address.startswith("serial://")
        result = ohmskin("live", "--headless", "--mode", "12B", "--seconds", "1", "--device", address)
    assert result.returncode == 0, result.stderr
    _, _, rows = result.stdout.partition("extent/cm2")  # before it may be told that quiet frames were measured again
    assert len(rows.splitlines()) >= 3


def test_scan_prints_what_was_driven_and_measured() -> None:
    result = command_line.ohmskin("scan", "--mode", "12B", "--json")
    data = json.loads(result.stdout)
    assert len(data["injections"]) == 12
    assert len(data["voltages"]) == len(data["measurements"]) == 108
    assert all(current > 0 for current in data["currents"])


def test_image_shows_the_targets(tank_folder: Path, tmp_path: Path) -> None:
    (file,) = (tank_folder / "electrode01_metal_electrode05_plastic").glob("*.csv")
    result = command_line.ohmskin("image", str(file), "--output", "picture.png", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "conducts better" in result.stdout
    assert "conducts worse" in result.stdout
    assert "resistive: none" not in result.stdout
    (file,) = (tank_folder / "electrode01_metal").glob("*.csv")
    told = json.loads(command_line.ohmskin("image", str(file), "--json", cwd=tmp_path).stdout)
    assert [one["there"] for one in told["classes"].values()] == [True, False]
    assert told["classes"]["conductive"]["area"] > 0 == told["classes"]["resistive"]["area"]
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_live_replays_a_recording(tank_folder: Path) -> None:
    (file,) = (tank_folder / "electrode01_metal_electrode05_plastic_electrode09_plastic").glob("*.csv")
    result = ohmskin("live", "--json", "--seconds", "1", "--device", f"replay:{file}")
    frame = json.loads(result.stdout.splitlines()[-1])
    signs = {}
    for contact in frame["contacts"]:
        x, y = contact["position"]
        signs[round(np.degrees(np.arctan2(y, x)) / 22.5) % 16] = np.sign(contact["strength"])
    assert signs == {0: 1, 4: -1, 8: -1}


def test_live_ends_cleanly_and_leaves_no_process_behind() -> None:
    """On the next port, where its own is in use."""
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with live("--mode", "12B", "--seconds", "60", port=port) as (address, process, before):
            until(lambda: len(children(process.pid)) == 2)  # the virtual skin and the page
            family = children(process.pid)
    assert all_gone(family)
    assert f"port {port} is in use" in before
    found = re.search(r"127\.0\.0\.1:(\d+)/", address)
    assert found
    assert int(found[1]) > port


def test_a_killed_live_takes_its_processes_with_it() -> None:
    command = [sys.executable, "-m", "ohmskin", "live", "--mode", "12B", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        until(lambda: len(children(process.pid)) == 2)
        family = children(process.pid)
        process.kill()
    assert all_gone(family)


def test_a_lost_device_is_told_and_found_again() -> None:
    def serve(port: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "ohmskin", "serve-skin", "--port", port]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    server = serve("0")
    assert server.stdout is not None
    address = re.search(r"tcp://\S+:(\d+)", server.stdout.readline())
    assert address
    command = [sys.executable, "-m", "ohmskin", "live", "--headless", "--mode", "12B", "--device", address[0]]
    sensed = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert sensed.stdout is not None
    os.set_blocking(sensed.stdout.fileno(), True)
    try:
        read_until(sensed, r"\d\d:\d\d:\d\d ")
        server.kill()
        server.wait()
        server.stdout.close()
        read_until(sensed, "device lost")
        server = serve(address[1])
        read_until(sensed, "device is back")
        read_until(sensed, r"\d\d:\d\d:\d\d ")
    finally:
        sensed.send_signal(signal.SIGINT)
        assert sensed.wait(120) == 0
        sensed.stdout.close()
        server.terminate()
        server.wait(120)
        assert server.stdout is not None
        server.stdout.close()


def read_until(process: "subprocess.Popen[str]", expression: str, seconds: float = 120) -> str:
    assert process.stdout is not None
    end = time.monotonic() + seconds
    seen = []
    for line in process.stdout:
        seen.append(line)
        if re.search(expression, line):
            return line
        if time.monotonic() > end:
            break
    raise AssertionError(f"no line with {expression!r} in {seen}")
