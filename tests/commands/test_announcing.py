"""What `hilserver run` shows: lines for people on a terminal, nothing but JSON elsewhere."""

import json
import os
import pty
import re
import select
import subprocess
import sys
import time

from tests.commands.test_cli import write_config

LIMIT_S = 600.0
STATUS = re.compile(
    r"running \| x -?\d+\.\d\d m, y -?\d+\.\d\d m, yaw -?\d+° \| peer drives"
    r" \| \d+\.\d\d x real time \| worst margin -?\d+\.\d\d ms"
)
LOG_LINE = re.compile(r"\d\d:\d\d:\d\d \[\w+ *\] \w")


def run_on_a_terminal(folder, *options, until):
    """Run under a pty and return what it showed up to `until`, without colours."""
    command = [sys.executable, "-m", "hilserver", "run", "-c", str(write_config(folder)), *options]
    master, slave = pty.openpty()
    environment = os.environ | {"COLUMNS": "200"}
    with subprocess.Popen(
        command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment
    ) as process:
        os.close(slave)
        shown, end_s = "", time.monotonic() + LIMIT_S
        try:
            while not until.search(shown) and time.monotonic() < end_s:
                if select.select([master], [], [], 1.0)[0]:
                    shown += os.read(master, 65536).decode()
        finally:
            process.terminate()
            while select.select([master], [], [], 20.0)[0]:
                try:
                    shown += os.read(master, 65536).decode()
                except OSError:  # the other side of the pty is closed
                    break
            assert process.wait(600) == 0
            os.close(master)
    return re.sub(r"\x1b\[[0-9;]*m", "", shown)


def test_a_terminal_shows_readable_lines_and_one_of_status(tmp_path):
    shown = run_on_a_terminal(tmp_path, "--demo", until=STATUS)
    assert STATUS.search(shown)
    lines = [line for line in re.split(r"[\r\n]|\x1b\[K", shown) if line.strip()]
    banner = lines.index("hilserver is running; stop it with Ctrl-C")
    assert lines[banner + 1].startswith("  OPC UA   opc.tcp://")
    others = [line for line in lines if not line.startswith(("hilserver is", "  ", "running |"))]
    assert all(LOG_LINE.match(line) for line in others if not line.startswith("starting")), others
    [degraded] = [line for line in lines if "degraded" in line] or [""]
    assert not degraded or "hilserver latency-test" in degraded


def test_elsewhere_every_line_is_json(tmp_path):
    command = [sys.executable, "-m", "hilserver", "run", "-c", str(write_config(tmp_path))]
    command += ["--demo", "--duration", "1", "--record", "out.mcap"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, cwd=tmp_path, check=True
    )
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    [running] = [line for line in lines if line["event"] == "hilserver is running"]
    assert running["opcua"].startswith("opc.tcp://")
    assert running["metrics"].startswith("http://")
    assert list(running["peers"]) == ["controller"]
    assert any("none lost" in line["event"] for line in lines)
    degraded = [line for line in lines if line["event"] == "degraded"]
    assert len(degraded) <= 1, "the audit is one line"
    for line in degraded:
        assert line["missing"].split(", ") == list(line["details"])
        assert all(item["wanted"] for item in line["details"].values())
