"""One builder, and nobody beside it."""

import re
from pathlib import Path

import pytest

from hilserver.config.root import Config
from hilserver.daemon import builder
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import Pace, build
from hilserver.image import ImageReader, Row
from tests.fakes import image_name

ROOT = Path(__file__).parents[2]


def assembly(**sections):
    return assemble_config(Config.model_validate(sections))


async def test_what_is_built_moves_the_robot_and_leaves_no_memory_behind():
    name = image_name()
    async with build(assembly(), Pace(image=name)) as core:
        slots = core.table["wheels.setpoints_rpm"].slots
        rows = [
            Row(slot, rpm) for slot, rpm in zip(slots, (30, 30, -30, -30), strict=True)
        ]
        assert core.image.push(rows)
        await core.scheduler.advance(1000)
        assert core.image.latest().values[core.table.slot("pose.x_m")] > 0.05
        assert ImageReader.attach(name).head == 1000
    with pytest.raises(Exception, match=name):
        ImageReader.attach(name)


def test_when_a_part_cannot_be_built_the_memory_is_given_back(monkeypatch):
    def refuse(*_):
        raise OSError("no compiler")

    monkeypatch.setattr(builder, "compose", refuse)
    name = image_name()
    with pytest.raises(OSError, match="no compiler"):
        build(assembly(), Pace(image=name))
    with pytest.raises(Exception, match=name):
        ImageReader.attach(name)


def test_the_pace_is_that_of_the_configuration():
    ours = assembly(
        scheduler={
            "backend": "timerfd",
            "policy": "skip",
            "limits": {"single_overrun_ms": 2.5, "consecutive_overruns": None},
            "realtime": {"priority": 7, "lock_memory": False},
        },
        control={"command_timeout_ms": 300},
        image={"name": "robot-7", "ring_frames": 512},
    )
    pace = Pace.configured(ours)
    assert (pace.backend, pace.image, pace.ring_frames) == ("timerfd", "robot-7", 512)
    assert (pace.policy.name, pace.limits.single_ns, pace.limits.consecutive) == (
        "skip",
        2_500_000,
        0,
    )
    assert (pace.realtime.priority, pace.realtime.lock_memory) == (7, False)
    assert (pace.command_limit_ticks, pace.paused) == (300, False)


def test_silence_is_counted_in_ticks_of_the_speed():
    core = build(assembly(), Pace(command_limit_ticks=40))
    try:
        core.watch_communication(500.0, speed=2.0)
        assert core.image.control.heartbeat_limit == 1000
        assert core.image.control.command_limit == 40
    finally:
        core.image.close()


def test_nobody_else_assembles_by_hand():
    files = [*ROOT.glob("hilserver/**/*.py"), *ROOT.glob("tests/**/*.py")]
    by_hand = {
        str(path.relative_to(ROOT))
        for path in files
        if re.search(r"import .*\bcompose\b", path.read_text(encoding="utf-8"))
    }
    assert by_hand == {"hilserver/kernel/__init__.py", "hilserver/daemon/builder.py"}
