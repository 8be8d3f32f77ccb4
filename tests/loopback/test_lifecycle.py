"""Beginning and end: exit codes, a stopped process, ten lives in one process."""

import asyncio
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ConfigError, FailedError
from tests.helpers.daemons import announced
from tests.helpers.prom_diff import series_of_text
from tests.loopback.rig import configuration

HERE = Path(__file__).parent
SETTINGS = """
image: {name: auto}
opcua: {enabled: false}
metrics: {port: 0}
logging: {format: json}
page: {enabled: false}
"""
REALTIME = "realtime: {priority: 0, lock_memory: false, hold_latency_target: false}"


@contextmanager
def daemon_process(folder, text):
    """`hilserver run` with a configuration; yields the process once it runs, and its log."""
    path = folder / "config.yaml"
    path.write_text(SETTINGS + text, encoding="utf-8")
    command = [sys.executable, "-m", "hilserver", "run", "-c", str(path)]
    lines = []
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, cwd=folder
    ) as process:
        reader = threading.Thread(
            target=lambda: lines.extend(process.stderr), daemon=True
        )
        reader.start()
        try:
            yield process, lines
        finally:
            process.terminate()
            process.wait(600)
            reader.join(120)


def wait_for(condition, timeout_s=120.0):
    end_s = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end_s, "it did not come"
        time.sleep(0.02)
    return found


def scrape(lines):
    url = wait_for(lambda: announced(list(lines)))["metrics"]
    with urllib.request.urlopen(url, timeout=120) as answer:
        return series_of_text(answer.read().decode())


def logged(lines):
    return [json.loads(line) for line in list(lines) if line.startswith("{")]


def test_policy_fail_ends_with_exit_code_3(tmp_path):
    text = f"""
scheduler: {{policy: fail, {REALTIME}}}
blocks:
  - {{name: busy, function: '{HERE / "blocks.py"}:always_busy', inputs: {{busy: lights.blue}}}}
"""
    with daemon_process(tmp_path, text) as (process, lines):
        assert process.wait(600) == 3
    assert "stopped by policy 'fail'" in "".join(lines)
    assert "Traceback" not in "".join(lines)


def test_a_stopped_process_is_a_late_wake_and_the_log_says_so(tmp_path):
    text = f"scheduler: {{policy: skip, {REALTIME}, slices: {{supervise: 100}}}}\n"
    late = (
        "hil_overruns_total",
        frozenset({("slice", "plant"), ("cause", "late_wake")}),
    )
    missed = ("hil_missed_ticks_total", frozenset({("slice", "plant")}))
    with daemon_process(tmp_path, text) as (process, lines):
        wait_for(lambda: any(line.get("event") == "running" for line in logged(lines)))
        time.sleep(0.3)
        before = scrape(lines)

        def stop():  # once more if its host took the processor at the same time: that is "stolen"
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.05)
            process.send_signal(signal.SIGCONT)
            time.sleep(0.3)
            return [line for line in logged(lines) if line.get("cause") == "stopped"]

        stopped = wait_for(stop)
        time.sleep(0.1)
        after = scrape(lines)
    assert after[late] >= before[late] + 1
    assert after[missed] >= before[missed] + 40
    assert any(
        line["slice"] == "plant" and line["kind"] == "late_wake" for line in stopped
    )
    assert process.returncode == 0


def names(folder):
    return [path.name for path in Path(folder).iterdir()]


async def resources():
    """What a process holds beside memory."""
    await asyncio.sleep(0.05)
    # the memory of an image, hence its descriptor, goes with its last view
    gc.collect()
    ours = f"hilserver-auto-{os.getpid()}-"
    return {
        "tasks": len(asyncio.all_tasks()),
        "descriptors": len(names("/proc/self/fd")),
        "pacing threads": sum(t.name == "pacing" for t in threading.enumerate()),
        "shared memory": sum(name.startswith(ours) for name in names("/dev/shm")),
        "collector callbacks": len(gc.callbacks),
    }


async def live_and_die(*, opcua):
    sections = {} if opcua else {"opcua": {"enabled": False}}
    async with Daemon(assemble_config(configuration(**sections))) as daemon:
        head = daemon.image.head
        async with asyncio.timeout(120):
            while daemon.image.head < head + 30:  # noqa: ASYNC110 - frames announce nothing
                await asyncio.sleep(0.005)


async def test_four_lives_in_one_process_leave_nothing_behind():
    await live_and_die(opcua=True)
    before = await resources()
    for life in range(4):
        await live_and_die(opcua=life == 0)  # its start takes longer than all the rest
    assert await resources() == before


async def test_a_daemon_that_cannot_be_made_leaves_no_shared_memory(tmp_path):
    (tmp_path / "own.py").write_text(
        "from hilserver.plant.blocks import Output, block\n"
        "@block(outputs=(Output('length_furlong', unit='furlong'),))\n"
        "def measure(dt_s, u, y, x, p):\n"
        "    y[0] = 1.0\n"
    )
    block = {"name": "mine", "function": "own.py:measure"}
    before = await resources()
    with pytest.raises(ConfigError, match="furlong"):
        Daemon(assemble_config(configuration(blocks=[block]), tmp_path))
    assert (await resources())["shared memory"] == before["shared memory"]


async def test_a_start_that_fails_gives_everything_back():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        endpoint = f"opc.tcp://127.0.0.1:{port}/hilserver"
        before = await resources()
        with pytest.raises(
            FailedError, match=rf"port {port} \(address already in use\); end the"
        ):
            await Daemon(
                assemble_config(configuration(opcua={"endpoint": endpoint}))
            ).__aenter__()
        assert await resources() == before
