"""The whole path: one skin, published everywhere at once."""

import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from ros_listener import PUBLISHED, Ears
from ros_listener import store as store
from tiers import FAST_DDS, GXX
from waiting import until

from ohmskin.client import Client
from ohmskin.client.remote import decode_contacts, is_loopback
from ohmskin.device import connect
from ohmskin.skin import Calibration, Skin


@pytest.fixture(scope="module")
def listener(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another maker's DDS, compiled where that can be, before there is a loop, which takes all the time it can get."""
    source, program = Path(__file__).with_name("fastdds_listener.cpp"), tmp_path_factory.mktemp("dds") / "listener"
    if FAST_DDS.met() and GXX.met():
        libraries = ("-lfastrtps", "-lfastcdr")
        subprocess.run(["g++", "-std=c++17", str(source), "-o", str(program), *libraries], check=True, timeout=300)
    return program


@pytest.fixture(scope="module")
def published(listener: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """`ohmskin live` as a user runs it, and the addresses that it prints."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    folder = str(tmp_path_factory.mktemp("live") / "boards")
    outlets = ["shm", f"zenoh:listen/{place}", "dds", "foxglove::0"]  # Foxglove where it is unless told, at a free port
    skin, layer = Skin.load("paper"), Skin.load("paper").contact_layer
    known = Calibration(layer_conductance=layer.conductance, layer_exponent=layer.exponent)
    file = tmp_path_factory.mktemp("skin") / "calibrated.toml"
    file.write_text(replace(skin, calibration=known).dump(), encoding="utf-8")
    command = [sys.executable, "-m", "ohmskin", "live", "--no-browser", "--no-demo", "--port", "0", "--skin", str(file)]
    process = subprocess.Popen(
        [*command, *(word for outlet in outlets for word in ("--publish", outlet))],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"OHMSKIN_BOARDS": folder},
    )
    assert process.stdout is not None
    seen = ""
    with ExitStack() as stack:  # whatever fails leaves no process and no session, whose thread would keep pytest alive
        stack.callback(process.stdout.close)
        stack.callback(process.wait)
        stack.callback(process.kill)
        for line in process.stdout:
            seen += line
            if "calibrating" in line:
                break
        found = re.search(r"publishing at (.*)", seen)
        device = re.search(r"tcp://\S+", seen)
        assert found, seen
        assert device, seen
        ears = Ears(place)
        stack.callback(ears.session.close)
        until(lambda: ears.of("contacts"))
        with connect(device[0]) as skin:
            skin.press(0, (0.06, 0.14), 8e-3, 20e3)
            until(lambda: sum(bool(decode_contacts(d, 0.0).contacts) for d, _, _ in ears.of("contacts")[-60:]) > 40)
            skin.press(0, (0.06, 0.14), 8e-3, 0.0)
        addresses = found[1].split(", ")
        yield {"ears": ears, "addresses": addresses, "device": device[0], "process": process, "boards": folder}
        ears.session.close()
        process.send_signal(signal.SIGTERM)
        rest = process.communicate(timeout=300)[0]
        assert process.returncode == 0, rest
        assert "Traceback" not in rest


def test_every_topic_arrives_with_its_type_and_hash(published: dict[str, Any], store: Any) -> None:
    until(lambda: len(published["ears"].heard) >= len(PUBLISHED))
    keys = {key.split("/", 1)[1] for key in published["ears"].heard}
    assert keys == {
        f"{topic[1:]}/{kind.replace('/', '::').replace('::msg::', '::msg::dds_::')}_/{store.hash_rihs01(kind)}"
        for topic, kind in PUBLISHED.items()
    }


def test_the_contact_is_where_it_was_pressed(published: dict[str, Any], store: Any) -> None:
    messages = [
        store.deserialize_cdr(data, PUBLISHED["/ohmskin/contacts"]) for data, _, _ in published["ears"].of("contacts")
    ]
    places = np.array([(c.position.x, c.position.y, c.position.z) for m in messages for c in m.contacts])
    assert len(places) > 20
    assert np.abs(np.median(places, axis=0) - [0.06, 0.14, 0.0]).max() < 4e-3
    numbers = np.array([m.sequence for m in messages])
    assert (np.diff(numbers) > 0).all()
    assert {(m.patches[0].name, m.patches[0].frame_id, m.patches[0].mode) for m in messages} == {
        ("skin", "skin", "16P")
    }
    pushes = [
        store.deserialize_cdr(data, PUBLISHED["/ohmskin/wrench"]).wrench
        for data, _, _ in published["ears"].of("wrench")
    ]
    forces = {c.force for m in messages for c in m.contacts}
    assert sum(-push.force.z in forces for push in pushes) > 20
    (end,) = {m.stamp.sec * 10**9 + m.stamp.nanosec for m in [messages[-1].header]}
    assert abs(end - time.time_ns()) < 60e9


def test_stamps_are_those_of_the_last_sample(published: dict[str, Any], store: Any) -> None:
    # Not the time of sending: a contacts message bears the very time of its patch's sample, and an image's stamp is
    # that of the contacts of its cycle, although it is sent later.
    contacts = [
        store.deserialize_cdr(data, PUBLISHED["/ohmskin/contacts"]) for data, _, _ in published["ears"].of("contacts")
    ]
    stamps = {m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in contacts}
    for m in contacts:
        assert m.header.stamp == m.patches[0].stamp
    images = [store.deserialize_cdr(data, PUBLISHED["/ohmskin/image"]) for data, _, _ in published["ears"].of("image")]
    shared = [i.header.stamp.sec * 10**9 + i.header.stamp.nanosec in stamps for i in images]
    assert np.mean(shared) > 0.5  # contacts of a cycle that came while the process was busy are passed over, so not all
    delays = np.array([at - stamped(data) for data, _, at in published["ears"].of("contacts")])
    assert delays.min() > 0


def stamped(data: bytes) -> int:
    """The stamp at the beginning of a message (ns)."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return seconds * 10**9 + nanoseconds


def test_diagnostics_tell_how_the_loop_is(published: dict[str, Any], store: Any) -> None:
    """The first message, before there is a rate, and the next ones."""
    heard = until(lambda: d if len(d := list(published["ears"].of("diagnostics"))) > 2 else None)
    (status,) = store.deserialize_cdr(heard[-1][0], PUBLISHED["/diagnostics"]).status
    assert (status.level, status.name, status.message) == (0, "ohmskin: skin", "running")
    values = {pair.key: float(pair.value) for pair in status.values}
    assert values["rate_Hz"] > 0
    assert values.keys() >= {"latency_p50_s", "latency_p99_s", "noise_V", "dropped", "waiting"}


def test_attachments_count_stamp_and_name_the_sender(published: dict[str, Any]) -> None:
    senders, steps = set(), list[int]()
    for key, messages in list(published["ears"].heard.items()):
        numbers = []
        for data, attachment, _ in messages:
            number, stamp, length, sender = struct.unpack("<qqB16s", attachment)
            assert length == 16
            if "Marker" not in key:  # which begins with the number of its markers
                assert stamp == stamped(data)
            numbers.append(number)
        senders.add(sender)
        steps += np.diff(numbers).tolist()
    assert len(senders) == len(PUBLISHED)
    assert min(steps) >= 1  # more than 1 where this busy process did not read in time: such messages are dropped
    assert np.mean(np.array(steps) == 1) > 0.5


def test_liveliness_tokens_tell_nodes_what_there_is(published: dict[str, Any], store: Any) -> None:
    tokens = [str(reply.ok.key_expr).split("/") for reply in published["ears"].session.liveliness().get("@ros2_lv/**")]
    nodes = [token for token in tokens if token[5] == "NN"]
    assert [token[6:] for token in nodes] == [["%", "%", "ohmskin_skin"]]
    entries = [token for token in tokens if token[5] == "MP"]
    assert len({token[4] for token in entries}) == len(PUBLISHED)  # each has a number of its own
    assert {token[9].replace("%", "/"): token[11] for token in entries} == {
        t: store.hash_rihs01(k) for t, k in PUBLISHED.items()
    }
    qos = {token[9]: token[12] for token in entries}
    assert qos["%ohmskin%contacts"] == "::,10:,:,:,,"  # reliable, as ROS 2 has it by default
    assert qos["%ohmskin%image"] == "2::,5:,:,:,,"  # best effort, for sensor data


def test_shared_memory_says_the_same(published: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OHMSKIN_BOARDS", published["boards"])
    with Client() as client:
        newest = until(client.newest)
    assert [patch.patch for patch in newest.patches] == ["skin"]
    data = until(
        lambda: next(
            (d for d, _, _ in published["ears"].of("contacts") if decode_contacts(d, 0.0).sequence == newest.sequence),
            0,
        )
    )
    far = decode_contacts(data, 0.0)
    assert (far.boot, far.stamp) == (newest.boot, newest.stamp)
    assert len(far.contacts) == len(newest.contacts)


def test_fast_dds_reads_it(published: dict[str, Any], listener: Path) -> None:
    with connect(published["device"]) as skin:
        skin.press(0, (0.15, 0.05), 8e-3, 20e3)
        told = subprocess.run([str(listener), "/ohmskin", "40"], stdout=subprocess.PIPE, text=True, timeout=300)
        skin.press(0, (0.15, 0.05), 8e-3, 0.0)
    out = told.stdout
    assert told.returncode == 0, out[-500:]
    lines = [json.loads(line) for line in out.splitlines()]
    found = {(line["stamp"], line["sequence"]): line for line in lines if line["topic"] == "contacts"}
    heard = {}
    for data, _, _ in list(published["ears"].of("contacts")):
        other = decode_contacts(data, 0.0)
        heard[other.stamp, other.sequence] = other
    both = found.keys() & heard.keys()
    assert len(both) > 20
    for key in both:
        line, other = found[key], heard[key]
        assert line["boot"] == other.boot
        assert line["patches"] == [["skin", "skin", other.stamp, "16P"]]
        assert line["contacts"] == [[0, c.id, *c.position, c.extent, c.strength] for c in other.contacts]
    assert any(line["contacts"] for line in found.values())
    images = [line for line in lines if line["topic"] == "image"]
    assert {(i["frame"], i["height"], i["width"], i["encoding"], i["step"]) for i in images} == {
        ("skin", 64, 64, "32FC1", 256)
    }
    sums = [
        float(np.nansum(np.frombuffer(data, "<f4", offset=len(data) - 4 * 64 * 64).astype(float)))
        for data, _, _ in published["ears"].of("image")
    ]
    assert any(np.isclose(sums, image["sum"], rtol=1e-6).any() for image in images)
    assert any(line["topic"] == "wrench" and line["force"][2] < 0 for line in lines)


def test_foxglove_lists_and_sends_every_topic(published: dict[str, Any], store: Any) -> None:
    from websockets.sync.client import connect as open_socket

    (address,) = [a for a in published["addresses"] if a.startswith("ws://")]
    with open_socket(address, subprotocols=["foxglove.sdk.v1"]) as socket_:  # type: ignore[list-item]
        channels: dict[str, Any] = {}
        while len(channels) < len(PUBLISHED):
            message = json.loads(socket_.recv(60))
            if message["op"] == "serverInfo":
                assert message.get("capabilities", []) in ([], ["time"])  # nothing that could be changed
            if message["op"] == "advertise":
                channels |= {channel["topic"]: channel for channel in message["channels"]}
        assert {topic: channel["schemaName"] for topic, channel in channels.items()} == PUBLISHED
        assert {(channel["encoding"], channel["schemaEncoding"]) for channel in channels.values()} == {
            ("cdr", "ros2msg")
        }
        wanted = channels["/ohmskin/contacts"]
        socket_.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": wanted["id"]}]}))
        while not isinstance(data := socket_.recv(60), bytes) or data[0] != 1:
            pass
        kind, subscription, at = struct.unpack_from("<BIQ", data)
        heard = store.deserialize_cdr(data[13:], "ohmskin_msgs/msg/Contacts")
        assert (kind, subscription, heard.patches[0].name) == (1, 1, "skin")
        assert at == heard.header.stamp.sec * 10**9 + heard.header.stamp.nanosec


def test_nothing_listens_beyond_this_machine(published: dict[str, Any]) -> None:
    family = [
        psutil.Process(published["process"].pid),
        *psutil.Process(published["process"].pid).children(recursive=True),
    ]
    assert len(family) >= 4  # the loop, the virtual skin, the page, the publisher
    open_ = [
        c
        for process in family
        for c in process.net_connections("inet")
        if c.status in (psutil.CONN_LISTEN, psutil.CONN_NONE)
    ]
    assert len(open_) >= 4
    reached = [c for c in open_ if not is_loopback(c.laddr.ip.removeprefix("::ffff:"))]
    assert {c.type for c in reached} <= {socket.SOCK_DGRAM}, reached  # those of DDS, which the next test looks at
    assert {c.laddr.port for c in reached} <= set(range(7400, 7500)) | set(range(32768, 65536)), reached
