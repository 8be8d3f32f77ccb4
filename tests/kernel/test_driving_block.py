"""A block that is a controller: its outputs are commands from the next tick on."""

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble, assemble_config
from hilserver.daemon.builder import Pace, build
from hilserver.errors import ConfigError
from hilserver.image import read_frames

BLOCK = """
from hilserver.plant.blocks import Output, block

@block(inputs=("x_m",), outputs=(Output("speed_m_s"), Output("mode")), parameters={"wild": 0.0})
def follow(dt_s, u, y, x, p):
    y[1] = 1.0
    y[0] = 0.3 if u[0] < 0.1 else 0.0
    if p[0] > 0.0 and u[0] > 0.05:
        y[0] = p[0]
"""
CONTROLLER = {
    "name": "follow",
    "function": "follow.py:follow",
    "slice": "sensors",
    "inputs": {"x_m": "pose.x_m"},
    "drives": {"speed_m_s": "twist.linear_m_s", "mode": "control.mode"},
}


def robot(folder, source="scenario", **controller):
    (folder / "follow.py").write_text(BLOCK)
    sections = {"control": {"source": source}, "blocks": [CONTROLLER | controller]}
    return assemble_config(Config.model_validate(sections), folder)


async def driven(assembly, n=1000):
    async with build(assembly, Pace()) as core:
        await core.scheduler.advance(n)
        frames = read_frames(core.image, 0, n)
        names = ("twist.linear_m_s", "follow.speed_m_s", "pose.x_m", "control.mode")
        return {name: frames.values[:, core.table.slot(name)] for name in names}


async def test_it_commands_from_the_next_tick_on(tmp_path):
    found = await driven(robot(tmp_path))
    commanded, wanted = found["twist.linear_m_s"], found["follow.speed_m_s"]
    assert commanded[0] == 0.0
    assert np.all(commanded[1:] == wanted[:-1])
    assert np.all(found["control.mode"][1:] == 1)
    assert 0.1 < found["pose.x_m"][-1] < 0.2  # it drove, and stopped where it should


async def test_others_who_have_control_are_not_disturbed(tmp_path):
    found = await driven(robot(tmp_path, source="opcua"), 50)
    assert not found["twist.linear_m_s"].any()
    assert found["follow.speed_m_s"][-1] == 0.3


@pytest.mark.parametrize("wild", [99.0, float("inf")])
async def test_what_is_out_of_range_is_not_commanded(tmp_path, wild):
    finite = min(wild, 1e300)
    found = await driven(robot(tmp_path, parameters={"wild": finite}))
    assert found["follow.speed_m_s"].max() == finite
    assert found["twist.linear_m_s"].max() == 0.3


@pytest.mark.parametrize(
    ("drives", "says"),
    [
        (
            {"speed": "twist.linear_m_s"},
            r"drives.speed: the block has no output 'speed'",
        ),
        ({"speed_m_s": "pose.x_m"}, "is not a scalar set-point"),
        ({"speed_m_s": "wheels.setpoints_rpm"}, "is not a scalar set-point"),
        ({"speed_m_s": "nothing"}, "is not a scalar set-point"),
    ],
)
def test_what_it_cannot_command_is_refused(tmp_path, drives, says):
    with pytest.raises(ConfigError, match=says):
        robot(tmp_path, drives=drives)


def test_a_block_without_commands_has_the_identity_that_it_had(tmp_path):
    with_commands = robot(tmp_path).identity["parameters"]
    assert with_commands != robot(tmp_path, drives={}).identity["parameters"]
    assert assemble(None).identity
