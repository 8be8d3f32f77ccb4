"""The own block of the documentation: put into a slice by configuration alone."""

import itertools
import re
from pathlib import Path

import pytest
import pytest_asyncio
import yaml

from hilserver.daemon.assembly import assemble
from tests.loopback.rig import call, column, frames, run_ticks, serving, text, uint32

pytestmark = pytest.mark.asyncio(loop_scope="module")

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "own-block.md"
GAIN_N_PCT, LAG_S, PERIOD_S = 0.4, 0.2, 0.01
SETTINGS = """
image: {name: auto, ring_frames: 8192}
opcua: {endpoint: 'opc.tcp://127.0.0.1:0/hilserver'}
metrics: {port: 0}
scheduler:
  limits: {single_overrun_ms: null, consecutive_overruns: null}
  realtime: {priority: 0, lock_memory: false, hold_latency_target: false}
"""


def listing(language):
    page = PAGE.read_text(encoding="utf-8")
    return re.search(rf"```{language}\n(.*?)```", page, re.DOTALL).group(1)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    (folder / "load_cell.py").write_text(listing("python"), encoding="utf-8")
    (folder / "config.yaml").write_text(SETTINGS + listing("yaml"), encoding="utf-8")
    async with serving(assemble(folder / "config.yaml")) as pair:
        yield pair


@pytest_asyncio.fixture(loop_scope="module")
async def driving(robot):
    daemon, client = robot
    assert await call(client, "Start") == "Good"
    assert await client.write_doubles(wheel__fl__setpoint_rpm=40.0) == ["Good"]
    await run_ticks(daemon, 60)
    return daemon, client


async def test_the_page_shows_fifteen_lines():
    lines = [line for line in listing("python").splitlines() if line.strip()]
    assert len(lines) <= 15
    (block,) = yaml.safe_load(listing("yaml"))["blocks"]
    assert block["slice"] == "sensors"


async def test_it_runs_every_10_ms_and_computes_what_it_says(driving):
    daemon, _ = driving
    slot = daemon.table.slot
    first = daemon.image.head
    await run_ticks(daemon, 300)
    history = list(frames(daemon, first))
    force = slot("load_cell.force_n")
    runs = [f for f in history if f.tick % 10 == 0]
    for before, after in itertools.pairwise(history):
        if after.tick % 10:
            assert after.values[force] == before.values[force], (
                "between its runs nothing changes"
            )
    share = PERIOD_S / (LAG_S + PERIOD_S)
    for before, after in itertools.pairwise(runs):
        old, duty = before.values[force], after.values[slot("wheel.fl.duty_pct")]
        expected = old + share * (GAIN_N_PCT * duty - old)
        assert after.values[force] == pytest.approx(expected, rel=1e-12)
    assert runs[-1].values[force] != runs[0].values[force]


async def test_it_is_visible_over_opc_ua_with_unit_and_range(driving):
    daemon, client = driving
    node = client.path("load_cell.force_n")
    shown = await client.data_value("load_cell.force_n")
    assert shown.StatusCode.is_good()
    assert shown.Value.Value in column(daemon, "load_cell.force_n")
    assert shown.Value.Value > 0.0
    limits = await (await node.get_child("0:EURange")).read_value()
    assert (limits.Low, limits.High) == (-50.0, 50.0)
    unit = await (await node.get_child("0:EngineeringUnits")).read_value()
    assert unit.DisplayName.Text == "N"
    assert (await node.read_description()).Text == "Load cell, axle fl"
    assert await client.write_doubles(load_cell__force_n=1.0) == ["BadNotWritable"]


async def test_its_state_is_part_of_the_snapshot(driving):
    daemon, client = driving
    values, _ = daemon.image.region("load_cell.x")

    async def step(n):
        first = daemon.image.head
        assert await call(client, "Step", uint32(n)) == "Good"
        await daemon.scheduler.wait_paused()
        return column(daemon, "load_cell.force_n", first)

    assert await call(client, "Pause") == "Good"
    await daemon.scheduler.wait_paused()
    assert await call(client, "SaveSnapshot", text("loaded")) == "Good"
    saved = values.copy()
    expected = await step(100)
    assert await client.write_doubles(wheel__fl__setpoint_rpm=-40.0) == ["Good"]
    await step(200)
    assert values[0] != saved[0]
    assert await call(client, "LoadSnapshot", text("loaded")) == "Good"
    assert values[0] == saved[0]
    assert await step(100) == expected
