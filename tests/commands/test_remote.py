"""Methods, signals and faults from the shell, against a real daemon."""

import re

import pytest

from hilserver.commands import main
from tests.helpers.daemons import running_daemon


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with running_daemon(tmp_path_factory.mktemp("robot")) as daemon:
        yield daemon


def test_the_shell_reaches_everything(robot, capsys):
    there = ["--endpoint", robot.url]
    assert main(["set", *there, "control.source=opcua"]) == 0
    assert (
        main(
            ["set", *there, '{"wheel.fl.setpoint_rpm": 5, "wheel.fr.setpoint_rpm": -5}']
        )
        == 0
    )
    assert main(["set", *there, "parameters.terms.dead_zone=2"]) == 0
    assert main(["set", *there, "parameters.terms.setpoint_rate_limit=null"]) == 0
    assert main(["set", *there, "parameters.kinematics.rotation_gain=tile"]) == 0
    assert main(["set", *there, "parameters.plant.exclusive_twist=true"]) == 0
    assert (
        main(
            [
                "call",
                *there,
                "SetParameter",
                "kinematics.rotation_gain",
                "geometric_skid",
            ]
        )
        == 0
    )
    fault = '{"fault": "bias", "signal": "battery.voltage_v", "offset": -2}'
    assert main(["inject", *there, fault]) == 0
    assert main(["call", *there, "ClearFaults"]) == 0
    assert main(["call", *there, "SetPose", "1", "0.5", "0"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["call", "SetPos", "1"],
            "there is no method 'SetPos'; did you mean 'SetPose'?",
        ),
        (["call", "SetPose", "1"], "SetPose takes 3 arguments: x, y, yaw"),
        (
            ["set", "wheel.fl.setpoint=1"],
            "there is no signal 'wheel.fl.setpoint'; did you mean",
        ),
        (["set", "wheel.fl.setpoint_rpm"], "write SIGNAL=VALUE"),
        (["inject", "{'fault'}"], "is not JSON; put it in single quotes"),
    ],
)
def test_words_that_can_never_work_are_one_sentence(capsys, words, sentence):
    assert main(words) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert sentence in line


def test_what_the_daemon_refuses_is_one_sentence(robot, capsys):
    asked = ["inject", '{"fault": "bais"}', "--endpoint", robot.url]
    assert main(asked) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "bais" in line


def test_nobody_there_is_one_sentence(capsys):
    assert main(["call", "--endpoint", "opc.tcp://127.0.0.1:9/x", "Stop"]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert re.search(r"does not answer \(connect.*\); 'hilserver run' starts it$", line)
