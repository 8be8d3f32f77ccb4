"""The tutorial's test of a user's controller: right robot, defects 1 and 2, both kinds of time."""

import re
import shutil
from pathlib import Path

import pytest

from tests.testing.test_plugin import LOAD

DOCS = Path(__file__).parents[2] / "docs" / "tutorial"
PROJECT = DOCS / "my-controller"
TURNS = "test_it_turns_to_a_heading_in_time"
STOPS = "test_the_robot_stops_when_the_controller_falls_silent"


@pytest.fixture
def verdicts(pytester, monkeypatch):
    """Run the tutorial's tests with some options; return the outcome of each."""
    shutil.copytree(PROJECT, pytester.path, dirs_exist_ok=True)
    monkeypatch.syspath_prepend(pytester.path)

    def run(*options):
        recorder = pytester.inline_run(*LOAD, "-p", "no:cacheprovider", *options)
        reports = recorder.getreports("pytest_runtest_logreport")
        return {r.nodeid.split("::")[1]: r for r in reports if r.when == "call"}

    return run


@pytest.mark.parametrize("mode", ["virtual", "realtime"])
def test_a_healthy_robot_passes(verdicts, mode):
    found = verdicts(f"--hil-mode={mode}")
    assert {name: r.outcome for name, r in found.items()} == {
        TURNS: "passed",
        STOPS: "passed",
    }


@pytest.mark.parametrize("mode", ["virtual", "realtime"])
def test_it_finds_the_missing_60_2pi(verdicts, mode):
    found = verdicts(f"--hil-mode={mode}", "--hil-fault=shield.yaw_rate_without_60_2pi")
    assert {name: r.outcome for name, r in found.items()} == {
        TURNS: "failed",
        STOPS: "passed",
    }
    assert (
        "pose.yaw_rad does not settle at 1.5708 +- 0.0523" in found[TURNS].longreprtext
    )


@pytest.mark.parametrize("mode", ["virtual", "realtime"])
def test_it_finds_the_dead_command_timeout(verdicts, mode):
    found = verdicts(f"--hil-mode={mode}", "--hil-fault=shield.dead_command_timeout")
    assert {name: r.outcome for name, r in found.items()} == {
        TURNS: "passed",
        STOPS: "failed",
    }
    assert (
        "velocity.linear_m_s does not settle at 0 +- 0.01" in found[STOPS].longreprtext
    )
    assert "it ends at 0.3 m/s" in found[STOPS].longreprtext


def test_controllers_over_opcua_pass(pytester):
    shutil.copytree(DOCS / "my-opcua-controller", pytester.path, dirs_exist_ok=True)
    outcome = pytester.runpytest_inprocess(*LOAD, "-p", "no:cacheprovider")
    outcome.assert_outcomes(passed=3)


def test_a_server_has_a_clock_of_its_own(pytester):
    text = (DOCS / "my-opcua-controller" / "test_server.py").read_text()
    pytester.makepyfile(text.replace('mode="realtime"', 'mode="virtual"'))
    pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")
    outcome = pytester.runpytest_inprocess(*LOAD, "-p", "no:cacheprovider")
    outcome.assert_outcomes(failed=1)
    outcome.stdout.fnmatch_lines(["*peers: 'plc' is connected and drives by a clock*"])


def test_the_tutorial_shows_the_files_as_they_are():
    text = (DOCS / "test-your-controller.md").read_text()
    blocks = re.findall(r"```(?:python|yaml)\n(.*?)```", text, re.DOTALL)
    files = [
        PROJECT / name for name in ("controller.py", "test_controller.py", "robot.yaml")
    ]
    for file in [*files, *(DOCS / "my-opcua-controller").glob("*.py")]:
        assert file.read_text() in blocks, f"{file.name} differs from the tutorial"
