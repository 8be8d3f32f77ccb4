"""What `hilserver run` shows: lines for people on a terminal, nothing but JSON elsewhere."""

import io
import json
import math
import os
import pty
import re
import select
import subprocess
import sys
import time

from hilserver.cache import Shelf
from hilserver.commands import announcing, compile_progress
from hilserver.commands.announcing import Announcer
from hilserver.commands.compile_progress import CompileProgress
from hilserver.compiled import cache
from hilserver.program.writer import Writer
from tests.commands.test_cli import write_config

LIMIT_S = 600.0
STATUS = re.compile(
    r"running \| x -?\d+\.\d\d m, y -?\d+\.\d\d m, yaw -?\d+° \| peer drives"
    r" \| \d+\.\d\d x real time \| worst margin -?\d+\.\d\d ms"
)
LOG_LINE = re.compile(r"\d\d:\d\d:\d\d \[\w+ *\] \w")


def run_on_a_terminal(folder, *options, until):
    """Run under a pty and return what it showed up to `until`, without colours."""
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "run",
        "-c",
        str(write_config(folder)),
        *options,
    ]
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
    others = [
        line
        for line in lines
        if not line.startswith(("hilserver is", "  ", "running |"))
    ]
    assert all(
        LOG_LINE.match(line) for line in others if not line.startswith("starting")
    ), others
    [degraded] = [line for line in lines if "degraded" in line] or [""]
    assert not degraded or "hilserver latency-test" in degraded


def test_elsewhere_every_line_is_json(tmp_path):
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "run",
        "-c",
        str(write_config(tmp_path)),
    ]
    command += ["--demo", "--duration", "1", "--record", "out.mcap"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        cwd=tmp_path,
        check=True,
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


def test_compiling_is_one_line_at_its_begin_and_one_at_its_end(tmp_path, monkeypatch):
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "shelf", lambda: Shelf("kernels-1"))
    now = [0.0]
    monkeypatch.setattr(compile_progress.time, "monotonic", lambda: now[0])
    for estimate in ("the first time, that takes a minute or two", "about 1 min 15 s"):
        with (tmp_path / "log").open("w+") as log:
            writer = Writer(log)
            announcer = Announcer(writer, "console")
            for _ in range(150):
                now[0] += 0.5
                announcer.compiling(["function"])
            announcer._say_compiled()
            writer.drain(10.0)
            first, last = (tmp_path / "log").read_text().splitlines()
        assert first.startswith(
            "hilserver is compiling the model for this computer: " + estimate
        )
        assert last == "hilserver has compiled 150 functions in 1 min 15 s"


def test_a_terminal_shows_how_long_compiling_still_takes():
    progress = CompileProgress(expected=200, s_per_function=math.inf)
    progress.add(5)
    assert progress.line == "compiling: 5 of about 200 functions"
    progress = CompileProgress(expected=200, s_per_function=0.5)
    assert progress.line == "compiling: 0 of about 200 functions, 1 min 40 s left"
    progress.count, progress.last_s = 150, 30.0
    assert progress.line == "compiling: 150 of about 200 functions, 10 s left"
    progress.expected = None
    assert progress.line == "compiling: 150 functions so far"
    progress.count, progress.expected = 210, 200
    assert progress.line == "compiling: 210 of about 210 functions, almost done"


def said_after(seconds, processor_s, *, waits_for="its libraries"):
    """What is said of a start that has lasted so long."""
    stream = io.StringIO()
    announcer = Announcer(Writer(stream), "console")
    announcer.waits_for = waits_for
    announcer.still_starting(seconds, processor_s)
    return stream.getvalue()


def test_a_long_start_says_what_it_waits_for_and_how_little_it_gets():
    text = said_after(40.0, 2.0)
    assert text.startswith(
        "hilserver is still starting after 40 s: it waits for its libraries;"
    )
    assert "5% of a core" in text
    assert "of a core" not in said_after(
        40.0, 35.0, waits_for="the embedded controller"
    )


def test_a_start_that_ends_in_time_says_nothing(monkeypatch):
    monkeypatch.setattr(announcing, "LONG_START_S", 0.01)
    stream = io.StringIO()
    announcer = Announcer(Writer(stream), "json")
    with announcer.patient():
        while "still starting" not in stream.getvalue():
            time.sleep(0.001)
    time.sleep(0.05)  # it may be saying it just now
    length = len(stream.getvalue())
    time.sleep(0.05)
    assert len(stream.getvalue()) == length
