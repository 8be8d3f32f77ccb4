"""A controller that is a process: it steps the robot over OPC UA, and may do anything."""

import shutil
import sys
from pathlib import Path

import pytest

from hilserver.errors import ConfigError
from hilserver.sweep.batch import rig_for
from hilserver.sweep.only import drive_again
from tests.node_red import node_red

EXAMPLE = Path(__file__).parents[2] / "examples" / "sweep"
REQUIRE = [{"name": "arrives", "signal": "pose.x_m", "above": 0.05, "within_s": 0.4}]
SHORT = {"drive": {"duration_s": 0.4}, "require": REQUIRE}
FAULT = {"fault": "noise", "signal": "pose.x_m", "sd": 0.001}

CLIENT = """
import asyncio, sys
from asyncua import Client, ua

async def main():
    async with Client(sys.argv[1]) as client:
        ns = await client.get_namespace_index("urn:hilserver:robot")
        methods = client.get_node(f"ns={ns};s=methods")
        for n in range(3):
            await methods.call_method(f"{ns}:Step", ua.Variant(50, ua.VariantType.UInt32))
            while await client.get_node(f"ns={ns};s=sim.tick").read_value() < 50 * n + 49:
                pass
        ACTION

asyncio.run(main())
"""


@pytest.fixture
def driven(made, tmp_path):
    """Drive machine 1 with a command; return its outcome."""

    def outcome(*command, time_s=60.0, memory_mb=1000.0, action=None, **sections):
        if action is not None:
            (tmp_path / "client.py").write_text(CLIENT.replace("ACTION", action))
            command = [sys.executable, "client.py", "{endpoint}"]
        controller = {"command": list(command), "lockstep": "opcua"}
        limits = {"time_s": time_s, "memory_mb": memory_mb}
        prepared = made(controller=controller, limits=limits, **(SHORT | sections))
        return prepared, rig_for(prepared.job).drive(prepared.machine(1))

    return outcome


def test_a_process_steps_the_robot_and_the_daemon_drives_the_same_again(
    driven, tmp_path
):
    shutil.copy(EXAMPLE / "stepping.py", tmp_path)
    faults = [{"share": 1, "fault": FAULT}]
    command = (sys.executable, "stepping.py", "{endpoint}")
    prepared, found = driven(*command, faults=faults)
    assert found.passed, found
    outcome = drive_again(prepared, 1, tmp_path / "again")  # raises if one bit differs
    assert outcome == found


@pytest.mark.long
def test_a_client_of_others_gives_the_same_bits(driven, monkeypatch):
    if sentence := node_red.missing():
        pytest.fail(sentence, pytrace=False)
    monkeypatch.setenv("NODE_PATH", str(node_red.HERE / "node_modules"))
    found = [
        driven(program, str(EXAMPLE / script), "{endpoint}")[1]
        for program, script in (
            (sys.executable, "stepping.py"),
            ("node", "stepping.js"),
        )
    ]
    assert found[0] == found[1]
    assert found[0].passed


def test_one_that_raises_fails_its_machine(driven):
    _, found = driven(action='raise RuntimeError("no idea")')
    said = "the controller ended with exit code 1: RuntimeError: no idea; the drive reached"
    assert found.error == f"{said} 0.15 s of 0.4 s"


def test_one_that_never_connects_fails_its_machine(driven):
    _, found = driven("sleep", "1000", time_s=0.5)
    assert "took longer than 0.5 s: the drive reached 0 s of 0.4 s" in found.error


@pytest.mark.long
@pytest.mark.parametrize(
    ("action", "says"),
    [
        ("return", "ended with exit code 0; the drive reached 0.15 s of 0.4 s"),
        ("sys.exit(3)", "ended with exit code 3"),
        ("import os; os.kill(os.getpid(), 9)", "was ended by SIGKILL"),
        (
            "await asyncio.sleep(1e6)",
            "took longer than 15 s: the drive reached 0.15 s of",
        ),
        ("while True: print('x' * 9999, file=sys.stderr)", "took longer than 15 s"),
        (
            "a = [bytearray(10**8) for _ in range(99)]",
            "ended with exit code 1: MemoryError",
        ),
        (
            "await methods.call_method(f'{ns}:Start'); await asyncio.sleep(1e6)",
            "the controller let the robot run freely (running)",
        ),
        (
            "await client.get_node(f'ns={ns};s=twist.linear_m_s').write_value(float('nan'))",
            "BadOutOfRange",
        ),
    ],
)
def test_whatever_one_does_its_machine_ends(driven, action, says):
    _, found = driven(action=action, time_s=15.0)
    assert says in found.error
    assert not found.margins


@pytest.mark.long
def test_what_it_has_started_ends_with_it(driven, tmp_path):
    script = "echo $$ > pids; sleep 1000 & echo $! >> pids; wait"
    driven("sh", "-c", script, time_s=2.0)
    for pid in map(int, (tmp_path / "pids").read_text().split()):
        stat = Path(f"/proc/{pid}/stat")
        assert not stat.exists() or " Z " in stat.read_text()


def test_a_program_that_does_not_exist(driven):
    _, found = driven("no-such-program", "{endpoint}")
    assert (
        "'no-such-program' cannot be started: no such file or directory" in found.error
    )


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"controller": {"command": ["a"]}}, "command needs lockstep"),
        ({"controller": {"command": ["a"], "lockstep": "s7"}}, "opcua"),
        (
            {"controller": {"command": ["a"], "lockstep": "opcua", "every_ms": 5}},
            "every_ms goes with python, not with command",
        ),
        (
            {"controller": {"command": ["a"], "lockstep": "opcua"}},
            "the controller is a program, and only it may command",
        ),
    ],
)
def test_what_a_file_cannot_mean(made, sections, says):
    with pytest.raises(ConfigError, match=says):
        made(**sections)
