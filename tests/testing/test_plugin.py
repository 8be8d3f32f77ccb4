"""The plug-in in somebody else's project: options, markers, reports, what is kept."""

import asyncio
import json
import re
import subprocess
import sys
import textwrap
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hilserver.__main__ import main
from hilserver.faults.scenario import load_scenario
from hilserver.logs import read_log
from hilserver.testing import tape
from hilserver.testing.keep import command, keep
from hilserver.testing.opening import open_hil

INSTALLED = any(point.name == "hilserver" for point in entry_points(group="pytest11"))
LOAD = () if INSTALLED else ("-p", "hilserver.testing.plugin")
STRICT = "-o", "asyncio_mode=strict"


@pytest.fixture
def project(pytester):
    """A project without any configuration of pytest."""
    pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")

    def run(source, *options):
        pytester.makepyfile(textwrap.dedent(source))
        return pytester.runpytest_inprocess(*LOAD, "-p", "no:cacheprovider", *options)

    return run


def test_both_kinds_of_tests_run_in_strict_and_in_auto_mode(project):
    source = """
        async def test_coroutine(hil):
            await hil.step(3)
            assert hil.tick == 4

        async def test_generator(hil):
            now_s = yield 3
            assert hil.tick == 4
            assert abs(now_s - 0.004) < 1e-12

        class TestClass:
            async def test_method(self, hil):
                yield
                assert hil.tick == 2
    """
    for mode in ("strict", "auto"):
        result = project(source, "-o", f"asyncio_mode={mode}")
        result.assert_outcomes(passed=3)


def test_an_assertion_in_a_generator_fails_and_everything_is_kept(project, pytester):
    result = project(
        """
        import pytest

        @pytest.mark.requirement("HIL-12", "HIL-13")
        async def test_wrong(hil):
            hil.write("wheel.fl.setpoint_rpm", 40.0)
            yield 100
            hil.inject({"fault": "noise", "signal": "pose.x_m", "sd": 0.1, "seed": 3})
            yield 100
            hil.clear_faults()
            yield 100
            assert hil.read("wheel.fl.speed_rpm") > 1000

        async def test_right(hil):
            yield
        """,
        *STRICT,
        "--junitxml=report.xml",
        "--hil-keep=kept",
    )
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        ["*recording, scenario and configuration: *kept*test_wrong*"]
    )
    (folder,) = (pytester.path / "kept").iterdir()
    run = json.loads((folder / "run.json").read_text())
    assert run["test"].endswith("::test_wrong")
    assert run["seed"] == 0
    log = read_log(folder / "recording.mcap")
    assert len(log) == 301
    assert log.is_ours
    assert log.run["seed"] == 0
    assert log.columns["wheel.fl.setpoint_rpm"][-1] == 40.0
    assert log.columns["sim.tick"].tolist() == list(range(301))
    scenario = load_scenario(folder / "scenario.yaml")
    assert scenario.steps[0].at_s == 0.001
    assert (scenario.faults[0].from_s, scenario.faults[0].until_s) == (0.101, 0.201)
    tree = ElementTree.parse(pytester.path / "report.xml")
    found = [
        p.get("value") for p in tree.iter("property") if p.get("name") == "requirement"
    ]
    assert found == ["HIL-12", "HIL-13"]


def test_a_failure_points_to_a_line_of_the_test(project):
    result = project(
        """
        async def test_refused(hil):
            hil.write("wheel.fl.setpoint_rpm", 500.0)
            yield

        async def test_out_of_its_band(hil):
            async with hil.capture("pose.x_m") as trace:
                yield 3
            trace["pose.x_m"].assert_within(low=1.0)

        async def test_wrong_wish(hil):
            yield 3
            yield 0.5
        """,
        *STRICT,
    )
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(
        ["*.py:2: HilError", "*.py:8: AssertionError", "*.py:12: HilError"]
    )
    result.stdout.no_fnmatch_line("*hilserver/testing/*.py:*")


async def test_what_was_kept_plays_again_to_the_bit(tmp_path, capsys):
    """The printed command replays what was written, injected, forced and set, and its margin."""
    slow = {"name": "slow", "signal": "wheel.fl.speed_rpm", "below": 5.0}
    async with open_hil({"plant": {"seed": 5}}, "virtual") as hil:
        hil.force("battery.voltage_v", 9.5)
        await hil.step(20)
        async with hil.capture() as trace:
            for i in range(10):
                hil.write(
                    {"wheel.fl.setpoint_rpm": 9.0 * i, "wheel.rl.setpoint_rpm": -i}
                )
                await hil.step(37)
                if i == 3:
                    await hil.set_parameter("plant.wheel_radius_m", 0.09)
                    hil.inject(
                        {
                            "fault": "drop",
                            "signal": "wheels.speeds_rpm",
                            "probability": 0.5,
                        }
                    )
                if i == 6:
                    hil.clear_faults()
                    hil.unforce("battery.voltage_v")
        margin = trace.margins(slow)["slow"]
        folder = keep(hil, tmp_path, "failed")
        words = command(hil, folder).split()
    assert words[:2] == ["hilserver", "replay"]
    assert await asyncio.to_thread(main, words[1:]) == 1
    said = capsys.readouterr().out
    assert "recorded outputs of 391 ticks are equal, bit for bit" in said
    assert re.search(rf"NOT MET +{re.escape(f'{margin:.6g}')}  slow", said)


async def test_a_replay_says_which_force_it_cannot_repeat(tmp_path, capsys):
    run, again = str(tmp_path / "run.mcap"), str(tmp_path / "again.mcap")
    async with open_hil({"recording": {"file": run}}, "virtual") as hil:
        hil.force("battery.voltage_v", 9.5)
        await hil.step(10)
    assert await asyncio.to_thread(main, ["replay", run, "-o", again, "--check"]) == 1
    assert "'battery.voltage_v' was forced (Force); a Force" in capsys.readouterr().err


async def test_a_long_test_is_kept_from_a_state_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tape, "KEPT_FRAMES", 3000)
    monkeypatch.setattr(tape, "STATE_EVERY", 1000)
    async with open_hil({}, "virtual") as hil:
        for rpm in range(30):
            hil.write("wheel.fl.setpoint_rpm", float(rpm))
            await hil.step(300)
        words = command(hil, keep(hil, tmp_path, "failed")).split()
    assert await asyncio.to_thread(main, words[1:]) == 0
    n_ticks = int(re.search(r"of (\d+) ticks are equal", capsys.readouterr().out)[1])
    assert 1000 <= n_ticks <= 3000


async def test_a_kept_recording_shows_where_time_was_set_back(tmp_path):
    async with open_hil({}, "virtual") as hil:
        await hil.step(20)
        hil.daemon.control.reset()
        await hil.step(30)
        log = read_log(keep(hil, tmp_path, "reset") / "recording.mcap")
    assert log.segment[0] == 0
    assert log.segment[-1] == 1
    assert log.columns["sim.tick"][log.segment == 1][-1] == 29


def test_options_reach_the_simulation(project, pytester):
    pytester.makefile(".yaml", robot="plant: {max_rpm: 33}\n")
    pytester.makefile(".yaml", play="steps: [{at_s: 0.0, write: {lights.red: 7}}]\n")
    result = project(
        """
        async def test_it(hil):
            yield 10
            assert hil.mode == "realtime"
            assert hil.daemon.config.plant.max_rpm == 33
            assert [a.name for a in hil.daemon.faults.active()] == ["shield.rpm_unsigned"]
            assert hil.read("lights.red") == 7
        """,
        *STRICT,
        "--hil-config=robot.yaml",
        "--hil-mode=realtime",
        "--hil-fault=shield.rpm_unsigned",
        "--hil-scenario=play.yaml",
    )
    result.assert_outcomes(passed=1)


@pytest.mark.parametrize(
    ("source", "options", "sentence"),
    [
        ("hil(config='no.yaml')", (), "*no.yaml: no such file*"),
        (
            "hil(config={'plant': {'mass': 1}})",
            (),
            "*configuration of hil: unknown key 'plant.mass'; *",
        ),
        (
            "hil(config={'plnt': {}})",
            (),
            "*configuration of hil: unknown key 'plnt'; did you mean 'plant'?",
        ),
        ("hil('robot.yaml')", (), "*write hil(config='robot.yaml')"),
        ("hil(config=5)", (), "*config of hil is a file or a mapping, not 5"),
        (
            "hil(scenario={'step': []})",
            (),
            "*scenario of hil: unknown key 'step'; did you mean 'steps'?",
        ),
        (
            "hil(scenario={'steps': [{'at_s': 0, 'write': {'pose.x': 1}}]})",
            (),
            "*there is no signal 'pose.x'; did you mean 'pose.x_m'?",
        ),
        (
            "hil(mode='fast')",
            (),
            "*the mode of hil is virtual or realtime, not 'fast'*",
        ),
        ("hil(speed=2)", (), "*the marker hil has no 'speed'*"),
        (
            "hil()",
            ("--hil-fault=shield.rust",),
            "*fault: 'shield.rust' is not valid; it should be 'stuck'*",
        ),
        (
            "hil()",
            ("--hil-scenario=bad.yaml",),
            "*bad.yaml:2: *there is no signal 'x'*",
        ),
    ],
)
def test_a_wrong_wish_is_one_sentence(project, pytester, source, options, sentence):
    pytester.makefile(".yaml", bad="faults:\n  - {fault: stuck, signal: x}\n")
    test = f"import pytest\n@pytest.mark.{source}\nasync def test_it(hil):\n    yield\n"
    result = project(test, *STRICT, *options)
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines([sentence])
    said = result.stdout.str()
    assert "Traceback" not in said
    assert "During handling" not in said  # before, the sentence came twice


def test_other_projects_pay_for_nothing_heavy(tmp_path):
    (tmp_path / "test_plain.py").write_text(
        "import sys\n\ndef test_plain():\n"
        "    heavy = {'numba', 'numpy', 'asyncua', 'pydantic', 'yaml', 'hilserver.daemon.daemon'}\n"
        "    assert not heavy & set(sys.modules)\n"
    )
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *LOAD, "-p", "no:hypothesispytest", "."],
        cwd=tmp_path,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert re.search(r"1 passed", run.stdout), run.stdout + run.stderr


def test_tests_with_a_robot_can_run_on_uvloop_as_the_daemon_does(project):
    source = """
        import asyncio

        import pytest

        def loop():
            return type(asyncio.get_running_loop()).__module__.partition(".")[0]

        async def test_coroutine(hil):
            assert loop() == "uvloop"
            await hil.step(3)

        @pytest.mark.hil(mode="realtime")
        async def test_generator(hil):
            hil.write("wheel.fl.setpoint_rpm", 30.0)
            yield 300
            assert loop() == "uvloop"
            assert hil.read("wheel.fl.speed_rpm") > 20.0

        @pytest.mark.asyncio
        async def test_of_others():
            assert loop() == "asyncio"
    """
    project(source, "--hil-loop=uvloop").assert_outcomes(passed=3)


def test_a_loop_that_does_not_exist_is_refused(pytester):
    pytester.makeini("[pytest]\nhil_loop = trio\n")
    ended = pytester.runpytest_subprocess(*LOAD)
    assert ended.ret == pytest.ExitCode.USAGE_ERROR
    ended.stderr.fnmatch_lines(["*the loop of hil is asyncio or uvloop, not 'trio'*"])
