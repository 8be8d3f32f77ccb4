"""A recording that spans the decision on a proposal comes again to the bit, the patch with it."""

import asyncio

from asyncua import ua

from hilserver.recalibration.history import History
from tests.helpers.daemons import running_daemon
from tests.io.opcua_server.rig import RobotClient
from tests.loopback.rig import wait_until
from tests.recalibration.waiting import ON, lay_ready
from tests.replay.conftest import wander
from tests.replay.test_patch import replay

RECORDING = "run.mcap"


async def accept_under_way(daemon):
    client = RobotClient(daemon.url)
    await client.connect()
    try:
        await wander(client, 0.6)
        code = (
            await client.call("AcceptProposal", ua.Variant(1, ua.VariantType.UInt32))
        ).StatusCode
        assert code.is_good()
        await wait_until(lambda: is_accepted(client))
        await wander(client, 0.6)
    finally:
        await client.disconnect()


async def is_accepted(client):
    return await client.read("recalibration.proposal.stage") == "accepted"


def test_a_recording_across_an_acceptance_comes_again_to_the_bit(tmp_path):
    lay_ready(tmp_path)
    with running_daemon(tmp_path, "--record", RECORDING, config=ON) as daemon:
        asyncio.run(accept_under_way(daemon))
        assert daemon.stop() == 0
    said = replay(RECORDING, "-o", "again.mcap", "--check", cwd=tmp_path)
    assert "equal, bit for bit" in said
    assert [line["kind"] for line in History(tmp_path / "recalibration").lines][:2] == [
        "proposal",
        "decision",
    ]
