"""Mistakes of a user in a hurry: what `check` must not let through, and the sentence he gets."""

import os
from itertools import pairwise
from pathlib import Path

import pytest

from hilserver.daemon.assembly import assemble
from hilserver.errors import ConfigError

READ = "read: {'ns=1;s=x': wheel.fl.setpoint_rpm}"


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in pairwise("abcdefghi")
)


def peer(text):
    return f"peers:\n  - {{name: a, endpoint: 'opc.tcp://h:1', {text}}}\n"


def complaint(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        assemble(path)
    return str(caught.value).replace(str(path), "config.yaml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # forms
        ("metrics:\n", ":1: metrics: is empty; remove it or add its keys"),
        ("peers:\n", ":1: peers: is empty; remove it or add its entries"),
        ("plant:\n  terms:\n", ":2: plant.terms: is empty"),
        ("- a\n", ":1: write 'key: value' lines, not a list"),
        ("hello\n", ":1: write 'key: value' lines, not 'hello'"),
        ("plant: [1]\n", ":1: plant: [1] is not valid; it should be keys and values"),
        (
            "peers: {name: a}\n",
            ":1: peers: {'name': 'a'} is not valid; it should be a list",
        ),
        ("1: 2\n", ":1: key '1' is not text; keys are words"),
        (
            "plant: {max_rpm: 1,0}\n",
            ":1: key 'plant.0' is not text; keys are words, and decimal",
        ),
        (
            "plant:\n  max_rpm: 1,0\n",
            "'1,0' is not valid; it should be a number with a decimal",
        ),
        (
            "plant:\n\tmax_rpm: 1\n",
            "cannot start any token; indent with spaces, not with tabs",
        ),
        ("plant: {null: 2}\n", ":1: key 'plant.None' is not text"),
        (
            "plant: {max_rpm: yes}\n",
            ":1: plant.max_rpm: True is not valid; it should be a number",
        ),
        (
            "kinematics: {rotation_gain: true}\n",
            ":1: kinematics.rotation_gain: True is not valid",
        ),
        (
            "kinematics: {rotation_gain: tiles}\n",
            ":1: kinematics.rotation_gain: 'tiles' is no",
        ),
        (
            "kinematics: {rotation_gain: null}\n",
            ":1: kinematics.rotation_gain: None is not valid",
        ),
        (
            "plant: {terms: {rotation_gian: 1}}\n",
            ":1: plant.terms.rotation_gian: there is no such term: did you mean 'rotation_gain'?",
        ),
        (
            "image: {name: '../x'}\n",
            ":1: image.name: '../x' is not valid; it should be text",
        ),
        # numbers
        (
            "image: {ring_frames: 1000}\n",
            ":1: image.ring_frames: 1000 is not a power of two; the n",
        ),
        (
            "scheduler: {base_period_ms: 0.001}\n",
            ":1: scheduler.base_period_ms: 0.001 is not valid",
        ),
        (
            "scheduler: {slices: {plant: 1e300}}\n",
            ":1: scheduler.slices.plant: 1e+300 is not valid",
        ),
        (
            "scheduler:\n  communication_timeout_ms: 10\n",
            ":1: scheduler: communication_timeout_ms is 10, but values are published every 20 ms",
        ),
        (
            "scheduler: {slices: {publish: 5000}}\n",
            ":1: scheduler: communication_timeout_ms is 2",
        ),
        # who commands
        ("control: {priority: []}\n", ":1: control: priority is empty"),
        (
            "control: {priority: [opcua, opcua]}\n",
            ":1: control: priority names 'opcua' twice",
        ),
        (
            "control: {priority: [scenario]}\n",
            ":1: control: source 'opcua' is not in pri",
        ),
        (
            peer(READ) + "control: {priority: [opcua]}\n",
            ": control: source 'peer' is not in",
        ),
        (
            "page: {enabled: false}\ncontrol: {source: page}\n",
            ":2: control.source: there is no 'page' here; sources are scenario, opcua, peer",
        ),
        # peers
        (
            peer("read: {'ns=1;s=x': internal.command}"),
            "there is no signal 'internal.command'",
        ),
        (
            peer(
                "read: {'ns=1;s=x': wheels.setpoints_rpm, 'ns=1;s=y': wheel.fl.setpoint_rpm}"
            ),
            "'wheel.fl.setpoint_rpm' is part of 'wheels.setpoints_rpm', which is also read",
        ),
        (
            peer("write: {wheels.speeds_rpm: 'ns=1;s=x'}"),
            "'wheels.speeds_rpm' is an array",
        ),
        (peer("read: {'ns=1;g=zz': wheel.fl.setpoint_rpm}"), "g= needs a GUID"),
        (peer("read: {'ns=1;b=%%%': wheel.fl.setpoint_rpm}"), "b= needs base64"),
        (
            peer("read: {'ns=1;i=99999999999': wheel.fl.setpoint_rpm}"),
            "i= needs a number up to",
        ),
        (
            peer("read: {'ns=70000;i=1': wheel.fl.setpoint_rpm}"),
            "ns= needs a number up to 65535",
        ),
        # blocks
        (
            "blocks:\n  - {name: a, function: x.py:f}\n  - {name: a, function: x.py:g}\n",
            ": two blocks have the name 'a'",
        ),
        (
            "blocks: [{name: pose, function: x.py:f}]\n",
            "blocks[0].name: 'pose' is reserved for the",
        ),
        # bombs
        ("a: " + "[" * 100 + "]" * 100 + "\n", "more than 50 levels deep"),
        ("a: " + "[" * 5000 + "]" * 5000 + "\n", "more than 50 levels deep"),
        ("plant: &a {terms: *a}\n", "more than 50 levels deep"),
        (
            BOMB,
            "more than 100000 values",
        ),
    ],
)
def test_told_in_one_sentence(tmp_path, text, expected):
    told = complaint(tmp_path, text)
    assert expected in told
    assert len(told.splitlines()) == 1
    assert len(told) < 400


@pytest.mark.parametrize(
    "text",
    [
        "plant: {max_rpm: 62, exclusive_twist: yes}\n",
        "\ufeffplant:\r\n  max_rpm: 62\r\n",
        "plant: {wheelbase_m: null}\n",
        "scheduler: {communication_timeout_ms: 0, slices: {publish: 5000}}\n",
        "control: {source: scenario, priority: [scenario]}\n",
    ],
)
def test_let_through(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_bytes(text.encode())
    assemble(path)


def test_what_is_no_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match="is a directory"):
        assemble(tmp_path)
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(ConfigError, match="not a regular file"):
        assemble(fifo)


def test_an_endless_file_is_not_read_to_its_end():
    with pytest.raises(ConfigError, match="/dev/zero: larger than"):
        assemble(Path("/dev/zero"))
