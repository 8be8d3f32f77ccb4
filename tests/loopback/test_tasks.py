"""Every task of a daemon with all its links is ended from outside: it is named, and it is back."""

import asyncio
import json
import urllib.error

import pytest

from hilserver import tasks
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from tests.helpers.daemons import free_port
from tests.loopback.rig import configuration, scrape, wait_until

NODE = "nsu=urn:iotbot:agv;s=rpm_set_FL"
GROUP = {"name": "drive", "signals": ["drive.enable"], "rate_hz": 2, "writable": True}
BLOCK = [{"signal": "wheel.fl.setpoint_rpm", "at": 0}]
KEPT = {
    "idle",
    "opcua clock",
    "opcua deadlines",
    "peer plc",
    "peer plc: watch",
    "edge",
    "edge: watch",
    "foxglove",
    "foxglove: watch",
    "s7: watch",
    "shield: watch",
}


def sections():
    """Every link that needs no other program; the peer and the broker are not there."""
    peer = {
        "name": "plc",
        "endpoint": f"opc.tcp://127.0.0.1:{free_port()}/UA/NodeRedAgv",
    }
    return {
        "peers": [peer | {"read": {NODE: "wheel.fl.setpoint_rpm"}}],
        "edge": {
            "enabled": True,
            "host": "127.0.0.1",
            "port": free_port(),
            "id": "agv",
            "groups": [GROUP],
        },
        "foxglove": {"enabled": True, "port": 0},
        "s7": {"server": {"port": 0, "blocks": {1: BLOCK}}},
        "shield": {"enabled": True},
    }


async def returns():
    await asyncio.sleep(0)


async def fails():
    await asyncio.sleep(0)
    raise ValueError("no bread")


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(tasks, "LONGEST_PAUSE_S", 0.01)


async def readiness(daemon):
    try:
        return json.loads(await scrape(daemon, "/readyz"))
    except urllib.error.HTTPError as error:
        return json.loads(await asyncio.to_thread(error.read))


async def test_no_task_ends_without_a_word(tmp_path, monkeypatch):
    async with Daemon(assemble_config(configuration(**sections()), tmp_path)) as daemon:
        kept = daemon.core.tasks
        jobs = [job for job in kept.jobs if job.lasting]
        assert {job.name for job in jobs} == KEPT

        for job in jobs:
            heard = len(daemon.events.recent)
            before = job.task
            before.cancel()  # by somebody who has nothing to do with it
            await wait_until(lambda: job.task is not before)  # noqa: B023
            what = f"task '{job.name}' was cancelled from outside; it begins again in 0.01 s"
            assert what in [event.message for event in daemon.events.recent[heard:]]

        for work, why in (
            (returns, "returned"),
            (fails, "failed: ValueError: no bread"),
        ):
            for job in jobs:
                real = job._make
                monkeypatch.setattr(job, "_make", work)
                job.task.cancel()
                await wait_until(lambda: job.why_down == why)  # noqa: B023
                monkeypatch.setattr(job, "_make", real)
                await wait_until(lambda: not job.task.done() and not job.why_down)  # noqa: B023
                assert any(
                    f"'{job.name}' {why}" in e.message for e in daemon.events.recent
                )

        assert all(kept.restarts[name] >= 5 for name in KEPT)
        exported = await scrape(daemon)
        for name in KEPT:
            assert f'hil_task_up{{task="{name}"}} 1.0' in exported
        await wait_until(lambda: daemon.supervision.first_ticks_met)
        assert (await readiness(daemon))["ok"]

        monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 1e3)
        monkeypatch.setattr(jobs[0], "_pause_s", 1e3)
        jobs[0].task.cancel()
        await asyncio.wait({jobs[0].task})
        judged = await readiness(daemon)
        assert (judged["ok"], jobs[0].name in judged["reason"]) == (False, True)
        down = f'hil_task_up{{task="{jobs[0].name}"}} 0.0'

        async def is_exported():  # an answer serves all scrapes of a moment
            return down in await scrape(daemon)

        await wait_until(is_exported)
    assert not kept.jobs, "the end of the daemon is the end of all its tasks"
