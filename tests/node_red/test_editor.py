"""The editor of the shipped settings: there when asked for, and on this computer only."""

import asyncio
import json
import urllib.error
import urllib.request

import pytest

from tests.helpers.daemons import free_port
from tests.node_red.node_red import shipped_flow

pytestmark = pytest.mark.node_red
LIMIT_S = 120.0


def get(url):
    with urllib.request.urlopen(url, timeout=120) as answer:
        return answer.read().decode()


async def test_the_editor_shows_the_shipped_flow(node_red):
    port = free_port()
    editor = {"IOTBOT_EDITOR": "1", "EDITOR_PORT": str(port)}
    instance = await node_red(shipped_flow(), environment=editor).start()
    url = f"http://127.0.0.1:{port}/"
    async with asyncio.timeout(LIMIT_S):
        while True:
            try:
                page = await asyncio.to_thread(get, url)
                flow = json.loads(await asyncio.to_thread(get, f"{url}flows"))
                break
            except (urllib.error.URLError, ConnectionError):
                await asyncio.sleep(0.2)
    assert "Node-RED" in page
    assert {node["id"] for node in flow} == {node["id"] for node in shipped_flow()}
    assert f"127.0.0.1:{port}" in instance.log


async def test_without_asking_there_is_no_editor(node_red):
    port = free_port()
    await node_red(shipped_flow(), environment={"EDITOR_PORT": str(port)}).start()
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", port)
