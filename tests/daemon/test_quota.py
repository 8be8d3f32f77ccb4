"""A daemon that gets a part of a core: who operates it gets in, and it says what it waits for."""

import asyncio
import contextlib
import json
import subprocess
import sys
import time
import urllib.request

import aiohttp
import pytest

from hilserver.commands.announcing import LONG_START_S
from hilserver.controller.nodes import demo_peer
from hilserver.opcua.passwords import hash_password
from tests.helpers.daemons import NO_LIMITS, running_daemon
from tests.helpers.prom_diff import series_of_text
from tests.helpers.quota import GROUP, control_group
from tests.page.rig import Plant, page_url
from tests.page.test_security import Visitor
from tests.page.test_users import make_certificate

pytestmark = pytest.mark.long

STOP_WITHIN_S = 2.0


def config():
    user = f"{{name: otto, password: '{hash_password('drive')}', role: operator}}"
    return (
        f"policies: [Basic256Sha256], users: [{user}]",
        f"page: {{port: 0}}\n{NO_LIMITS}",
    )


async def operate(url, plant):
    """Log in, see a frame, stop; return how long each took [s]."""
    took_s, began_s = {}, time.monotonic()

    def note(what):
        nonlocal began_s
        took_s[what], began_s = time.monotonic() - began_s, time.monotonic()

    jar = aiohttp.CookieJar(unsafe=True)
    async with aiohttp.ClientSession(cookie_jar=jar) as session:
        visitor = Visitor(session, url)
        async with asyncio.timeout(600):
            while True:
                try:
                    await visitor.load()
                    break
                except (
                    aiohttp.ClientError
                ):  # the page is a process of its own, which still starts
                    await asyncio.sleep(0.1)
            note("load")
            status, answer = await visitor.call("login", "otto", "drive")
            assert (status, answer["ok"]) == (200, True), answer
            note("log in")
            socket = await visitor.live()
            await socket.send_json({"subscribe": ["sim.tick"], "number": 1})
            while not isinstance((await socket.receive()).data, bytes):
                pass
            note("see")
            await socket.send_json({"stop": 1})
            while plant.value("internal.command") != 2:  # noqa: ASYNC110 - the plant tells nobody
                await asyncio.sleep(0.001)
            note("stop")
    return took_s


@contextlib.contextmanager
def controller():
    """The controller of the demo, with all of its computer; give its endpoint."""
    words = [sys.executable, "-m", "hilserver.controller"]
    words += ["--endpoint", "opc.tcp://127.0.0.1:0/UA/NodeRedAgv"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.kill()


def connected(daemon):
    """Whether the peer is connected, or is again."""
    with urllib.request.urlopen(daemon.metrics_url, timeout=60) as answer:
        series = series_of_text(answer.read().decode())
    return series["hil_peer_connected", frozenset({("peer", "controller")})] == 1.0


def wait_until(condition, within_s=120.0):
    """Whether it becomes true in time."""
    end_s = time.monotonic() + within_s
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.2)
    return condition()


@pytest.mark.parametrize("share", [0.25, 0.05])
def test_an_operator_logs_in_sees_and_stops_and_no_link_is_lost(
    tmp_path, monkeypatch, share
):
    """Before, a start of a minute said nothing, and a log-in at 5 % was near its limit of 20 s."""
    opcua, rest = config()
    with controller() as endpoint, control_group(share) as group:
        # the robot has to wait for our Stop
        peer = demo_peer(endpoint).changed(on_stale="zero")
        rest += f"peers: {json.dumps([peer.model_dump(mode='json')])}\n"
        monkeypatch.setenv(GROUP, str(group))
        began_s = time.monotonic()
        with running_daemon(
            tmp_path,
            config=rest,
            opcua=opcua,
            program="tests.helpers.quota",
            prepare=make_certificate,
        ) as daemon:
            took_s = {"start": time.monotonic() - began_s}
            took_s |= asyncio.run(operate(page_url(daemon), Plant(daemon.image)))
            is_connected = wait_until(lambda: connected(daemon))
            lines = (tmp_path / "daemon.log").read_text(encoding="utf-8").splitlines()
    print({what: round(seconds, 3) for what, seconds in took_s.items()})
    said = {line["event"]: line for line in map(json.loads, lines)}
    assert took_s["stop"] < STOP_WITHIN_S
    assert is_connected
    assert said["degraded"]["details"]["cgroup_cpu"]["found"].startswith("quota")
    if took_s["start"] > 2 * LONG_START_S:
        assert "of a core" in said["still starting"]["why"]
