"""A controller in a process of its own: robot and controller wait for each other."""

import asyncio
import contextlib
import hashlib
import re
import sys
from pathlib import Path

import pytest

from hilserver.__main__ import main
from hilserver.program.children import python, started
from hilserver.testing.hil import HilError
from hilserver.testing.keep import command, keep
from hilserver.testing.opening import open_hil

HERE = Path(__file__).parent
OPCUA = {"opcua": {"enabled": True}}
CONTROLLER = sys.executable, HERE / "stepping_controller.py", "{endpoint}"
YAW, RATE = "pose.yaw_rad", "twist.angular_rad_s"
REQUIRE = [
    {"name": "arrives", "signal": YAW, "above": 0.48, "within_s": 1.4},
    {"name": "does not overshoot", "signal": YAW, "below": 0.52, "always": True},
    {"name": "keeps its limit", "signal": RATE, "below": 0.81, "always": True},
]
FOUND = {
    "": [],
    "sign": ["arrives"],
    "gain": ["arrives"],
    "limit": ["keeps its limit"],
    "slow": ["does not overshoot"],
}


async def drive(bug="", parts=(1500,)):
    """Drive once; return which requirements are not met, and a hash of every signal."""
    async with open_hil(OPCUA, "virtual") as hil:
        command = *CONTROLLER, *filter(None, [bug])
        async with hil.capture() as trace:
            async with hil.controller(*command, patience_s=600):
                for n in parts:
                    await hil.step(n)
            await hil.step(100)  # its set-points have ended with it
        found = [name for name, m in trace.margins(*REQUIRE).items() if m < 0.0]
        columns = b"".join(trace[name].values.tobytes() for name in sorted(trace))
        return found, hashlib.sha256(columns).hexdigest()


async def test_the_right_controller_passes_the_same_however_the_test_steps():
    """In `make test-long` two hundred times."""
    ways = [(1500,), (7, 1, 41, 1451)]
    drives = await asyncio.gather(*(drive("", way) for way in ways))
    assert [names for names, _ in drives] == [[], []]
    assert drives[0][1] == drives[1][1]


@pytest.mark.parametrize(
    "bug",
    [
        "sign",
        "limit",
        pytest.param("gain", marks=pytest.mark.long),
        pytest.param("slow", marks=pytest.mark.long),
    ],
)
async def test_a_planted_bug_is_found(bug):
    assert (await drive(bug))[0] == FOUND[bug]


async def test_what_failed_replays_without_its_controller(tmp_path, capsys):
    async with open_hil(OPCUA, "virtual") as hil:
        async with hil.controller(*CONTROLLER, "limit"), hil.capture(RATE) as trace:
            hil.force("battery.voltage_v", 9.5)
            await hil.step(300)
        margin = trace.margins(REQUIRE[2])["keeps its limit"]
        words = command(hil, keep(hil, tmp_path, "failed")).split()
    assert margin < 0.0
    assert await asyncio.to_thread(main, words[1:]) == 1
    said = capsys.readouterr().out
    assert "of 301 ticks are equal, bit for bit" in said
    assert re.search(rf"NOT MET +{re.escape(f'{margin:.6g}')}  keeps its", said)


@pytest.mark.long
@pytest.mark.parametrize("n_busy", [0, 8])
async def test_two_hundred_repeats_are_equal_beside_busy_processes(n_busy):
    async with contextlib.AsyncExitStack() as ending:
        for _ in range(n_busy):
            command = python("-c", "import os; os.nice(19)\nwhile True: pass")
            busy = started(command, name="busy", stop_limit_s=0)
            await ending.enter_async_context(busy)
        for bug, expected in FOUND.items():
            assert (await drive(bug))[0] == expected
        hashes = {(await drive())[1] for _ in range(200)}
    assert len(hashes) == 1


# --- wrong controllers ----------------------------------------------------------------------------

CLIENT = """
import asyncio, sys
from asyncua import Client, ua

async def main():
    async with Client(sys.argv[1]) as client:
        ns = await client.get_namespace_index("urn:hilserver:robot")
        methods = client.get_node(f"ns={ns};s=methods")
        mode = client.get_node(f"ns={ns};s=control.mode")
        n = ua.Variant(50, ua.VariantType.UInt32)
        ACTION

asyncio.run(main())
"""
STEP = "await methods.call_method(f'{ns}:Step', n)"
WRITES = "await mode.write_value(ua.Variant(1, ua.VariantType.Byte))"


@pytest.mark.parametrize(
    ("action", "patience_s", "says"),
    [
        ("raise RuntimeError('no idea')", 600, "exit code 1: RuntimeError: no idea"),
        (
            STEP,
            600,
            "the controller ended with exit code 0, at 0.051 s, while the test",
        ),
        (f"while True: {WRITES}", 600, "commands and does not call Step; in virtual"),
        pytest.param(
            *(f"{STEP}; {STEP}; await asyncio.sleep(600)", 600, "only one controller"),
            marks=pytest.mark.long,
        ),
        pytest.param(
            *(f"{STEP}; await asyncio.sleep(600)", 2, "has not called Step for"),
            marks=pytest.mark.long,
        ),
        pytest.param(
            *("await asyncio.sleep(600)", 2, "no controller has called Step for"),
            marks=pytest.mark.long,
        ),
    ],
)
async def test_a_controller_that_does_not_step_is_named(
    tmp_path, action, patience_s, says
):
    client = tmp_path / "client.py"
    client.write_text(CLIENT.replace("ACTION", action))
    async with open_hil(OPCUA, "virtual") as hil:
        command = sys.executable, client, "{endpoint}"
        with pytest.raises(HilError, match=says):
            async with hil.controller(*command, patience_s=patience_s):
                await hil.step(200)


async def test_a_controller_of_another_process_outside_lockstep_is_refused(tmp_path):
    client = tmp_path / "client.py"
    client.write_text(CLIENT.replace("ACTION", f"{WRITES}; await asyncio.sleep(600)"))
    async with open_hil(OPCUA | {"control": {"source": "opcua"}}, "virtual") as hil:
        command = python(str(client), hil.endpoint)
        async with started(command, name="controller", stop_limit_s=0):
            while not hil.daemon.gate.present:  # noqa: ASYNC110 - of the server
                await asyncio.sleep(0.05)
            with pytest.raises(HilError, match=r"another process \(127\.0\.0\.1:\d+\)"):
                await hil.step()


async def test_wrong_blocks_fail_with_a_sentence():
    async with open_hil(OPCUA, "virtual") as hil:
        with pytest.raises(HilError, match="has not called Step while its block ran"):
            async with hil.controller():
                pass
        with pytest.raises(HilError, match="there is a controller already"):
            async with hil.controller(), hil.controller():
                pass
        with pytest.raises(HilError, match="'no-such' cannot be started: no such file"):
            async with hil.controller("no-such"):
                pass
        hil.controller("python", "controller.py")
        with pytest.raises(HilError, match="without async with, so no controller ran"):
            hil.check_awaited()
