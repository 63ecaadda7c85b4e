"""The live page's process and its protocol, without a browser."""

import http.client
import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ohmskin.errors import ViewError
from ohmskin.view import LiveView
from ohmskin.view.live import enqueue
from ohmskin.view.wire import CommandError, check_setup, pack_frame, read_command, to_json

NX, NY = 5, 4
SETUP: dict[str, Any] = {
    "version": "0.1.0",
    "skin": {
        "name": "small",
        "domain": {"kind": "rectangle", "width": 0.2, "height": 0.16},
        "electrodes": [{"x": 0.0, "y": 0.0}, {"x": 0.2, "y": 0.16}],
    },
    "raster": {"x0": 0.02, "y0": 0.02, "pitch": 0.04, "nx": NX, "ny": NY},
    "modes": [
        {"name": "16O", "title": "adaptive", "available": True, "why_not": "", "injections": [1, 16]},
        {"name": "16I", "title": "adjacent", "available": False, "why_not": "no inner electrodes"},
    ],
    "choices": {
        name: [{"name": choice, "title": choice} for choice in choices]
        for name, choices in (("estimator", ("gauss-newton", "kalman")), ("prior", ("paper",)), ("rule", ("physical",)))
    },
    "device": {"url": "virtual:", "virtual": True},
    "unit": "mS",
    "press": {"radius": [0.002, 0.02, 0.008], "pressure": [1e3, 1e5, 2e4]},
}
IMAGE = np.arange(NX * NY, dtype=float).reshape(NY, NX)
ESTIMATOR = {"type": "estimator", "estimator": "kalman", "prior": "paper", "rule": "physical"}
PRESS = {"type": "press", "id": "a", "x": 0.05, "y": 0.12, "radius": 0.008, "pressure": 2e4}


@pytest.fixture(scope="module")
def view() -> Iterator[LiveView]:
    with LiveView(SETUP, port=0) as view:
        yield view


@pytest.fixture
def fresh() -> Iterator[LiveView]:
    """A view of one's own, without frames and commands of other tests."""
    with LiveView(SETUP, port=0) as view:
        yield view


def open_socket(view: LiveView, **more: Any) -> ClientConnection:
    return connect(
        view.url.replace("http", "ws").replace("/?", "/socket?").removesuffix("/")
        + ("" if "?" in view.url else "/socket"),
        **more,
    )


def get(view: LiveView, path: str = "/", **headers: str) -> http.client.HTTPResponse:
    channel = http.client.HTTPConnection("127.0.0.1", view.port, timeout=60)
    channel.request("GET", path, headers=headers)
    response = channel.getresponse()
    response.read()
    channel.close()
    return response


def read_frame(message: str | bytes) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    assert isinstance(message, bytes)
    (length,) = struct.unpack_from("<I", message)
    assert length % 4 == 0
    header = json.loads(message[4 : 4 + length])
    base, image = np.frombuffer(message, "<f4", offset=4 + length).reshape(2, NY, NX)
    return header, base, image


def publish(view: LiveView, sequence: int) -> None:
    until(view.wants_frame)
    view.publish({"sequence": sequence}, -IMAGE, sequence + IMAGE)


# --- who is let in ----------------------------------------------------------------------------------------------------


def test_page_and_its_files_are_served_with_a_strict_policy(view: LiveView) -> None:
    for path in ("/", "/static/app.js", "/static/style.css"):
        response = get(view, path)
        assert response.status == 200
        policy = response.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert response.headers["x-content-type-options"] == "nosniff"
    assert get(view, "/static/app.js").headers["content-type"].startswith("text/javascript")
    assert get(view, "/static/../server.py").status == 404


@pytest.mark.parametrize(
    "name", ["127.0.0.1:{port}", "localhost:{port}", "[::1]:{port}", "LOCALHOST:{port}", "localhost:9999"]
)
def test_loopback_names_are_let_in(view: LiveView, name: str) -> None:
    assert get(view, Host=name.format(port=view.port)).status == 200


@pytest.mark.parametrize(
    "name",
    ["evil.example", "evil.example:{port}", "localhost.evil.example", "127.0.0.1@evil.example", "", "192.168.0.7"],
)
def test_foreign_host_header_is_refused(view: LiveView, name: str) -> None:
    assert get(view, Host=name.format(port=view.port)).status == 403
    assert get(view, "/static/app.js", Host=name.format(port=view.port)).status == 403
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "A" * 22 + "==",
    }
    assert get(view, "/socket", Host=name.format(port=view.port), **upgrade).status == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://localhost:{port}.evil.example"]
)
def test_foreign_origin_is_refused(view: LiveView, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        open_socket(view, origin=origin.format(port=view.port)).close()
    assert refused.value.response.status_code == 403


def test_own_origin_is_let_in(view: LiveView) -> None:
    with open_socket(view, origin=f"http://127.0.0.1:{view.port}") as browser:
        assert json.loads(browser.recv(60))["type"] == "setup"


def test_token_guards_page_and_socket() -> None:
    with LiveView(SETUP, port=0, token="open-sesame") as view:
        assert view.url.endswith("/?token=open-sesame")
        assert get(view, "/").status == 403
        assert get(view, "/?token=open-sesamE").status == 403
        assert get(view, "/?token=open-sesame").status == 200
        with open_socket(view) as browser:
            assert json.loads(browser.recv(60))["type"] == "setup"
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{view.port}/socket").close()


def test_other_machines_need_a_token() -> None:
    for host in ("0.0.0.0", "192.168.0.7", "robot.local", "::"):
        with pytest.raises(ViewError, match="token"):
            LiveView(SETUP, host=host, port=0)
    with pytest.raises(ViewError, match="8 to 256"):
        LiveView(SETUP, port=0, token="short")
    with LiveView(SETUP, host="0.0.0.0", port=0, token="open-sesame") as view:
        assert get(view, "/?token=open-sesame", Host=f"robot.local:{view.port}").status == 200
        assert get(view, "/", Host=f"robot.local:{view.port}").status == 403


# --- frames -----------------------------------------------------------------------------------------------------------


def test_frame_arrives_as_it_was_published(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        setup = json.loads(browser.recv(60))
        assert setup["raster"] == SETUP["raster"]
        publish(fresh, 7)
        header, base, image = read_frame(browser.recv(60))
        assert header["sequence"] == 7
        np.testing.assert_array_equal(base, -IMAGE)
        np.testing.assert_array_equal(image, 7 + IMAGE)


def test_no_browser_no_frame(fresh: LiveView) -> None:
    assert not fresh.wants_frame()
    fresh.publish({"sequence": 1}, IMAGE, IMAGE)  # dropped
    with open_socket(fresh) as browser:
        browser.recv(60)
        until(fresh.wants_frame)
        with pytest.raises(TimeoutError):
            browser.recv(0.05)


def test_slow_browser_gets_the_newest_frame_only(fresh: LiveView) -> None:
    with open_socket(fresh) as slow, open_socket(fresh) as quick:
        for browser in (slow, quick):
            browser.recv(60)
        for sequence in range(1, 21):
            publish(fresh, sequence)
            assert read_frame(quick.recv(60))[0]["sequence"] == sequence
            quick.send(to_json({"type": "ack", "sequence": sequence}))
        assert read_frame(slow.recv(60))[0]["sequence"] == 1
        slow.send(to_json({"type": "ack", "sequence": 2}))  # of a frame that it was not sent: does not count
        with pytest.raises(TimeoutError):
            slow.recv(0.1)
        slow.send(to_json({"type": "ack", "sequence": 1}))
        assert read_frame(slow.recv(60))[0]["sequence"] == 20


def test_publish_never_waits_for_a_browser_that_does_not_read(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        browser.recv(60)
        publish(fresh, 1)
        taken = []
        for sequence in range(2, 2000):
            start = time.perf_counter()
            fresh.wants_frame()
            fresh.publish({"sequence": sequence}, IMAGE, IMAGE)
            taken.append(time.perf_counter() - start)
        assert np.quantile(taken, 0.99) < 0.05  # others on the machine may hold up a few


def test_a_refused_frame_costs_no_credit() -> None:
    with LiveView(SETUP, port=0) as view, open_socket(view) as browser:
        browser.recv(60)
        until(view.wants_frame)
        with pytest.raises(ViewError, match="shapes"):
            view.publish({"sequence": 1}, IMAGE[:1], IMAGE)
        assert view.wants_frame()
        view.publish({"sequence": 2}, IMAGE, IMAGE)
        assert isinstance(browser.recv(60), bytes)


def test_header_with_numpy_values_and_numbers_that_are_not_finite() -> None:
    header = {
        "sequence": np.int64(3),
        "health": {"latency_p50": math.nan, "rate": np.float64(5.0)},
        "pairs": np.array([[0, 1]]),
    }
    message = pack_frame(header, IMAGE, np.full_like(IMAGE, np.nan))
    plain, _, image = read_frame(message)
    assert plain == {"sequence": 3, "health": {"latency_p50": None, "rate": 5.0}, "pairs": [[0, 1]]}
    assert np.isnan(image).all()


# --- commands ---------------------------------------------------------------------------------------------------------


def asked(view: LiveView, count: int) -> list[dict[str, Any]]:
    """So many commands, as soon as they have arrived."""
    told: list[dict[str, Any]] = []
    until(lambda: told.extend(view.commands()) or len(told) >= count)
    return told


def test_commands_arrive_in_order_and_ids_name_the_browser(fresh: LiveView) -> None:
    with open_socket(fresh) as one, open_socket(fresh) as two:
        names = [json.loads(browser.recv(60))["client"] for browser in (one, two)]
        one.send(to_json(PRESS))
        told = asked(fresh, 1)
        two.send(to_json(PRESS | {"x": 0.1}))
        two.send(to_json({"type": "mode", "mode": "16O"}))
        assert told + asked(fresh, 2) == [
            PRESS | {"id": f"{names[0]}:a"},
            PRESS | {"id": f"{names[1]}:a", "x": 0.1},
            {"type": "mode", "mode": "16O"},
        ]
        assert fresh.commands() == []


def test_presses_of_a_browser_that_leaves_are_lifted(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        name = json.loads(browser.recv(60))["client"]
        for key in "abc":
            browser.send(to_json(PRESS | {"id": key}))
        browser.send(to_json({"type": "lift", "id": "b"}))
        asked(fresh, 4)
    assert asked(fresh, 2) == [{"type": "lift", "id": f"{name}:{key}"} for key in "ac"]


REFUSED = [
    *("", "nonsense", "[]", "1", "null", "[" * 4000),
    *('{"type":"format_disk"}', '{"type":["press"]}', '{"type":"calibrate","now":true}', '{"type":"press","id":"a"}'),
    *(json.dumps(PRESS | {"x": x}) for x in (0.2001, -1e-6, "0.1", True, None, math.nan, math.inf, 10**400)),
    to_json(PRESS).replace("0.05", "1e999"),
    *(to_json(PRESS | change) for change in ({"radius": 0.0}, {"pressure": 1.1e5}, {"y": 0.17})),
    *(to_json(PRESS | {"id": name}) for name in ("", "a" * 33, "b1:a", "a\n", 5)),
    *(to_json({"type": "mode", "mode": mode}) for mode in ("16I", "99", None, [])),
    *(to_json({"type": "ack", "sequence": sequence}) for sequence in (-1, 1.0, True, 2**53)),
    '{"type":"pause","paused":1}',
    *(to_json({"type": "injections", "count": count}) for count in (0, 17, 2.0, True, "4")),
    '{"type":"demo","on":"yes"}',
    *(to_json(ESTIMATOR | wrong) for wrong in ({"estimator": "nosuch"}, {"prior": "kalman"}, {"rule": None})),
    to_json(ESTIMATOR | {"x": 1}),
    to_json({"type": "estimator", "estimator": "kalman"}),
]


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_malformed_commands_are_refused(text: str) -> None:
    with pytest.raises(CommandError):
        read_command(text, SETUP)


@given(
    st.text()
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda inner: st.dictionaries(st.text(), inner)
    ).map(json.dumps)
)
def test_no_text_does_harm(text: str) -> None:
    try:
        command = read_command(text, SETUP)
    except CommandError:
        return
    assert command["type"] in ("lift_all", "calibrate")


@given(st.floats(0, 0.2), st.floats(0, 0.16), st.floats(0.002, 0.02), st.floats(1e3, 1e5))
def test_presses_in_range_pass_unchanged(x: float, y: float, radius: float, pressure: float) -> None:
    press = PRESS | {"x": x, "y": y, "radius": radius, "pressure": pressure}
    assert read_command(json.dumps(press), SETUP) == press


def test_an_estimator_is_chosen_of_those_in_the_setup() -> None:
    assert read_command(to_json(ESTIMATOR), SETUP) == ESTIMATOR
    with pytest.raises(CommandError, match="estimator must be one of gauss-newton, kalman"):
        read_command(to_json(ESTIMATOR | {"estimator": "tikhonov"}), SETUP)
    with pytest.raises(CommandError, match="no choice of estimator"):
        read_command(to_json(ESTIMATOR), {name: part for name, part in SETUP.items() if name != "choices"})


def test_real_skin_cannot_be_pressed_from_the_page() -> None:
    with pytest.raises(CommandError, match="not virtual"):
        read_command(to_json(PRESS), SETUP | {"press": None})


def test_a_press_on_a_skin_of_any_outline_must_be_within_its_box() -> None:
    domain = {"kind": "polygon", "outline": [[-0.1, 0.0], [0.2, 0.1], [0.0, 0.3]], "holes": []}
    setup = SETUP | {"skin": SETUP["skin"] | {"domain": domain}}
    check_setup(setup)
    assert read_command(to_json(PRESS | {"x": -0.05, "y": 0.25}), setup)["x"] == -0.05
    with pytest.raises(CommandError, match="y must be from 0 to"):
        read_command(to_json(PRESS | {"y": 0.31}), setup)


def test_refused_command_is_answered_and_the_browser_stays(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        browser.recv(60)
        browser.send(to_json(PRESS | {"x": 9}))
        answer = json.loads(browser.recv(60))
        assert answer["type"] == "refused"
        assert "x must be from 0 to 0.2" in answer["message"]
        browser.send(b"binary")
        assert "text" in json.loads(browser.recv(60))["message"]
        browser.send(to_json({"type": "calibrate"}))
        assert asked(fresh, 1) == [{"type": "calibrate"}]


def test_message_that_is_too_long_ends_the_connection(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        browser.recv(60)
        browser.send(" " * 5000)
        with pytest.raises(ConnectionClosed):
            browser.recv(60)
    with open_socket(fresh) as browser:
        assert json.loads(browser.recv(60))["type"] == "setup"


def test_number_of_presses_is_limited(fresh: LiveView) -> None:
    with open_socket(fresh) as browser:
        browser.recv(60)
        for k in range(33):
            browser.send(to_json(PRESS | {"id": f"p{k}"}))
        assert "at most 32" in json.loads(browser.recv(60))["message"]


def test_moves_of_a_press_are_merged_but_never_across_a_lift() -> None:
    pending: list[dict[str, Any]] = []
    moves = [PRESS | {"x": 0.01 * k} for k in range(3)]
    other = PRESS | {"id": "b"}
    for command in [moves[0], other, moves[1], {"type": "lift", "id": "a"}, moves[2], {"type": "lift_all"}, moves[0]]:
        enqueue(pending, command)
    assert pending == [moves[1], other, {"type": "lift", "id": "a"}, moves[2], {"type": "lift_all"}, moves[0]]


# --- the process ------------------------------------------------------------------------------------------------------


def test_taken_port_gives_the_next_one() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with LiveView(SETUP, port=port) as view:
            assert view.port_was_taken
            assert port < view.port <= port + 20
            assert str(view.port) in view.url
            assert get(view).status == 200


def test_close_leaves_no_process_and_is_safe_twice() -> None:
    before = set(threading.enumerate())
    view = LiveView(SETUP, port=0)
    child = psutil.Process(view.pid)
    with open_socket(view) as browser:
        browser.recv(60)
        view.close()
        view.close()
    assert not child.is_running()
    assert set(threading.enumerate()) <= before
    assert not view.wants_frame()
    view.publish({"sequence": 1}, IMAGE, IMAGE)
    assert view.commands() is not None


def test_interrupt_is_left_to_the_loop(view: LiveView) -> None:
    os.kill(view.pid, signal.SIGINT)
    time.sleep(0.2)
    assert get(view).status == 200


def test_loop_survives_the_death_of_the_page(caplog: pytest.LogCaptureFixture) -> None:
    with LiveView(SETUP, port=0) as view:
        with open_socket(view) as browser:
            browser.recv(60)
            until(view.wants_frame)
            psutil.Process(view.pid).kill()
            until(lambda: not view.wants_frame())
        view.publish({"sequence": 1}, IMAGE, IMAGE)
        until(lambda: "has ended" in caplog.text)


def test_page_ends_when_its_loop_is_killed() -> None:
    code = f"from ohmskin.view import LiveView; v = LiveView({SETUP!r}, port=0)\n"
    code += "print(v.pid, flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as loop:
        assert loop.stdout is not None
        child = psutil.Process(int(loop.stdout.readline()))
        loop.kill()
        loop.wait()
        until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)


def test_start_that_fails_says_why() -> None:
    with pytest.raises(ViewError, match="no-such-host"):
        LiveView(SETUP, host="no-such-host.invalid", port=0, token="open-sesame")


@pytest.mark.parametrize(
    "broken",
    [
        {},
        SETUP | {"choices": {"estimator": ["kalman"]}},
        SETUP | {"press": {"radius": [1, 2, 3], "pressure": [1, 2, 1]}},
        SETUP | {"raster": {"nx": 3}},
        SETUP | {"skin": SETUP["skin"] | {"domain": {"kind": "sphere", "radius": 1}}},
    ],
)
def test_incomplete_setup_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(ViewError):
        LiveView(broken, port=0)
