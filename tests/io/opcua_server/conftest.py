"""One server per module: its start takes more than a second."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from tests.io.opcua_server.rig import Rig, RobotClient, connected


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    folder: Path = tmp_path_factory.mktemp("snapshots")
    rig = Rig(folder)
    await rig.server.start()
    yield rig
    await rig.close()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(rig: Rig) -> AsyncIterator[RobotClient]:
    async with connected(rig) as client:
        yield client
