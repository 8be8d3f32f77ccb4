"""A link tries again, whatever ended its session."""

import asyncio

import pytest
import wait_for2

from hilserver.io.peer_link.link import Peer
from hilserver.time_limit import time_limit
from tests.io.opcua_client.conftest import make_harness, peer_config, wait_until


async def answer_and_time_out_meet():
    """asyncua waits by `wait_for2`, which raises a subclass of CancelledError then."""
    loop = asyncio.get_running_loop()
    answer = loop.create_future()
    async with time_limit(0):
        loop.call_soon(answer.set_result, 1)
        await wait_for2.wait_for(answer, 2)


async def library_cancels_its_request():
    """As asyncua does with every open request when the connection breaks."""
    answer = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_soon(answer.cancel)
    await answer


async def subclass_leaks():
    raise wait_for2.CancelledWithResultError(1, None)


@pytest.mark.parametrize(
    "session", [answer_and_time_out_meet, library_cancels_its_request, subclass_leaks]
)
async def test_a_link_whose_session_ended_by_a_cancellation_tries_again(session):
    harness = make_harness(peer_config(1))
    assert isinstance(harness.link, Peer)
    harness.link.converse = session
    await harness.link.start()
    await wait_until(lambda: harness.status.failed_attempts >= 2, timeout_s=5)
    await harness.link.stop()
    assert harness.status.last_error
