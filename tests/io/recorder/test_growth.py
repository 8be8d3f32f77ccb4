"""A recording says how fast it grows, before the disk is full."""

import re

import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.io.recorder import Recorder, Settings
from hilserver.logs.writer import size_of
from tests.loopback.rig import wait_until

TICKS = 10_500


@pytest.mark.parametrize(
    ("name", "bag"), [("run.mcap", None), ("packed", "mcap"), ("plain", "sqlite3")]
)
async def test_its_size_per_hour_is_said_early_and_at_its_end(
    tmp_path, capsys, name, bag
):
    assembly = assemble_config(Config(scheduler={"backend": "virtual"}))
    async with build(assembly) as core:
        recorder = Recorder(
            core.image.name, Settings(tmp_path / name, waits=True, bag=bag)
        )
        for _ in range(TICKS // 500):
            await core.scheduler.advance(500)
            recorder.look()
        # a disk keeps up with the plant's time, but not with that of this test
        await wait_until(lambda: recorder._writing.written == TICKS, 60.0)
        end = recorder.run(0.0)
    size_gb = size_of(tmp_path / name) * 1e-9 * 3600 / (TICKS * 1e-3)
    early, late = (
        float(re.search(r"([0-9.e+]+) GB per hour", text)[1])
        for text in (capsys.readouterr().err, end)
    )
    assert late == pytest.approx(size_gb, rel=0.1)
    assert early == pytest.approx(size_gb, rel=0.5)


async def test_a_rotation_has_its_own_limits_and_a_moment_says_nothing(
    tmp_path, capsys
):
    assembly = assemble_config(Config(scheduler={"backend": "virtual"}))
    async with build(assembly) as core:
        path = tmp_path / "run.mcap"
        short = Recorder(core.image.name, Settings(path, waits=True))
        await core.scheduler.advance(100)
        assert "per hour" not in short.run(0.0)
        rotating = Recorder(
            core.image.name, Settings(path, waits=True, rotate_bytes=10**9)
        )
        rotating._seen = TICKS
        assert "per hour" not in rotating.run(0.0)
    assert "grows" not in capsys.readouterr().err
