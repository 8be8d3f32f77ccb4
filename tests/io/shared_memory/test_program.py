"""A compiled program of somebody else reads and writes the shared memory of a running daemon."""

import asyncio
import json
import re
import shutil
import textwrap
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.image.shared_file import path_of
from hilserver.io.shared_memory.headers import to_c, to_csharp
from hilserver.io.shared_memory.inputs import (
    COUNTER,
    LAYOUT,
    SharedInputs,
    inputs_of,
    name_of,
)
from hilserver.signals import State
from tests.loopback.rig import configuration, newest, wait_until

SOURCE = Path(__file__).with_name("drive.c")
ROOT = Path(__file__).parents[3]
LIMIT_MS = 2000


@asynccontextmanager
async def daemon_with(**section):
    config = configuration(
        shared_memory=section | {"stale_after_ms": LIMIT_MS},
        opcua={"enabled": False},
        page={"enabled": False},
    )
    async with Daemon(assemble_config(config)) as daemon:
        yield daemon


async def compiled(folder, table, image="robot", source=SOURCE):
    """Return the program, compiled with the header of a table."""
    compiler = shutil.which("cc")
    assert compiler, "this test needs a C compiler (Debian: gcc libc6-dev)"
    (folder / "hilserver.h").write_text(to_c(table, image))
    program = folder / "drive"
    words = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{folder}", source]
    process = await asyncio.create_subprocess_exec(
        compiler, *words, "-o", program, "-lm"
    )
    assert await process.wait() == 0
    return program


async def run(program, daemon, rpm, cycles):
    """Return exit code, what the program saw, and its complaint."""
    image = daemon.image.name
    process = await asyncio.create_subprocess_exec(
        program,
        *(path_of(image), path_of(name_of(image)), str(rpm), str(cycles)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    said, complaint = await process.communicate()
    return process.returncode, json.loads(said or "null"), complaint.decode().strip()


async def test_a_program_in_c_drives_and_reads_every_name_at_its_place(tmp_path):
    async with daemon_with(grants=["command"]) as daemon:
        program = await compiled(tmp_path, daemon.table, daemon.image.name)
        code, seen, complaint = await run(program, daemon, 30, 400)
        assert (code, complaint) == (0, "")
        assert seen["frames"] == 400
        assert seen["asked"] == 30
        assert seen["speed"] > 25
        assert seen["x"] > 0
        assert seen["status"] == 0
        # what it read is bit for bit what the daemon published in that frame
        frame = daemon.image.frame(seen["sequence"] // 2 - 1)
        assert frame is not None
        assert frame.tick == seen["tick"]
        for name, key in {"wheel.fl.speed_rpm": "speed", "pose.x_m": "x"}.items():
            assert frame.values[daemon.table.slot(name)] == seen[key]
        # it is gone: the robot stops
        link = daemon.part("shared_memory")
        assert link.status.writes > 0
        assert daemon.gate.owner == "peer"
        await wait_until(
            lambda: daemon.control.state is State.SAFE and link.status.stale
        )
        assert daemon.control.reason == "the program in shared memory is silent"
    assert not link._inputs.path.exists()


async def test_the_example_of_the_documents_reads_the_robot(tmp_path):
    page = (ROOT / "docs/how-to/shared-memory.md").read_text()
    (example,) = re.findall(r"```c\n(.*?int main.*?)```", page, re.S)
    source = tmp_path / "example.c"
    source.write_text(textwrap.dedent(example))
    async with daemon_with() as daemon:
        program = await compiled(tmp_path, daemon.table, daemon.image.name, source)
        process = await asyncio.create_subprocess_exec(
            program, stdout=asyncio.subprocess.PIPE
        )
        said, _ = await process.communicate()
        assert process.returncode == 0
        assert re.fullmatch(rb"tick \d+: 0\.00 rpm\n", said)


async def test_without_a_grant_a_program_only_reads(tmp_path):
    async with daemon_with() as daemon:
        program = await compiled(tmp_path, daemon.table)
        code, seen, _ = await run(program, daemon, "nan", 3)
        assert code == 0
        assert seen["frames"] == 3
        code, _, complaint = await run(program, daemon, 30, 3)
        assert code == 1
        assert complaint.endswith("see shared_memory.grants")
        assert newest(daemon, "wheel.fl.setpoint_rpm") == 0


async def test_a_grant_of_measured_values_commands_nothing(tmp_path):
    async with daemon_with(grants=["measured"]) as daemon:
        program = await compiled(tmp_path, daemon.table)
        code, seen, _ = await run(program, daemon, 30, 20)
        assert code == 0
        assert seen["asked"] == 0
        assert daemon.gate.rejected["peer:memory", "not_granted"] > 0


async def test_a_header_of_another_robot_is_refused(tmp_path):
    other = assemble_config(configuration(mechatronic={"enabled": True})).table
    async with daemon_with(grants=["command"]) as daemon:
        program = await compiled(tmp_path, other)
        code, _, complaint = await run(program, daemon, 30, 3)
        assert code == 1
        assert complaint == (
            "the robot has other signals: make this file again, with its configuration"
        )


def counted(inputs, values, counter):
    inputs._values[:] = np.nan
    inputs._values[: len(values)] = values
    inputs._words[COUNTER] = counter


@pytest.fixture
def inputs():
    table = assemble_config(configuration()).table
    made = SharedInputs("auto-inputs-test", table)
    yield made
    made.close()


def test_what_is_half_written_or_old_is_no_news(inputs):
    assert inputs.news() is None
    counted(inputs, [12.0], 1)
    assert inputs.news() is None  # odd: the program is writing
    inputs._words[COUNTER] = 2
    first = inputs._signals[0].name
    assert inputs.news() == {first: 12.0}
    assert inputs.news() is None
    inputs._words[COUNTER] = 4
    assert inputs.news() == {first: 12.0}  # repeated: the program is alive
    assert inputs._words[LAYOUT] > 0


def test_both_languages_have_the_same_members_in_the_same_order():
    table = assemble_config(configuration()).table

    def members(text, kind):
        found = [
            line.split()
            for line in text.splitlines()
            if f"{kind} " in line and ";" in line
        ]
        return [
            words[words.index(kind) + 1].rstrip(";") for words in found if kind in words
        ]

    names = [s.name.replace(".", "_") for s in table.scalars]
    written = [s.name.replace(".", "_") for s in inputs_of(table)]
    in_c = members(to_c(table, "robot"), "double")
    in_csharp = [
        n for n in members(to_csharp(table, "robot"), "double") if n[0].islower()
    ]
    assert in_c[: len(names)] == in_csharp[: len(names)] == names
    assert in_csharp[len(names) :] == written
