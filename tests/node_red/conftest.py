"""Fixtures with a real Node-RED; without it they fail and say how to install it."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from tests.helpers.daemons import free_port
from tests.node_red.node_red import NodeRed, missing


@pytest.fixture
async def node_red(tmp_path: Path) -> AsyncIterator[Callable[..., NodeRed]]:
    """Return a factory of Node-RED installations on a free port; all are ended afterwards."""
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    made: list[NodeRed] = []

    def make(flow: list[dict], **settings: object) -> NodeRed:
        instance = NodeRed(
            tmp_path / f"node-red-{len(made)}", free_port(), flow, **settings
        )
        made.append(instance)
        return instance

    yield make
    for instance in made:
        await instance.kill()
