"""One stock server and one of ours per module, with the same certificates."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.io.opcua_server.rig import Rig
from tests.security.pki import Pki
from tests.security.stock import Stock


@pytest.fixture(autouse=True)
def _strangers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attackers are somebody else's programs, and have no patience to expect."""
    monkeypatch.setattr("hilserver.opcua.transport.is_own_program", lambda *_: False)


@pytest.fixture(scope="session")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Pki:
    return Pki(tmp_path_factory.mktemp("pki"))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def stock(pki: Pki) -> AsyncIterator[Stock]:
    stock = Stock()
    await stock.start(pki)
    yield stock
    await stock.stop()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def ours(
    pki: Pki, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("snapshots"), **pki.config())
    await rig.server.start()
    rig.control.started()
    rig.gate.request("opcua", "opcua")
    rig.tick()
    yield rig
    await rig.close()
