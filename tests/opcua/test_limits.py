"""What one client can ask for, life and death of the server, and its log."""

import asyncio
import math
import socket
from pathlib import Path

import pytest
import structlog
from asyncua import ua
from pydantic import ValidationError

from hilserver.config.server import OpcUaConfig
from hilserver.errors import FailedError
from hilserver.opcua import subscriptions, transport
from tests.io.opcua_server.rig import Rig, RobotClient, connected

pytestmark = pytest.mark.asyncio(loop_scope="module")


class Ignore:
    def datachange_notification(
        self, node: object, value: object, data: object
    ) -> None:
        pass


def own_tasks() -> set[str]:
    return {task.get_coro().__qualname__ for task in asyncio.all_tasks()}


@pytest.mark.parametrize("asked_ms", [0.0, -1.0, 0.01, math.nan])
async def test_publishing_interval_has_a_lower_bound(
    client: RobotClient, asked_ms: float
) -> None:
    params = ua.CreateSubscriptionParameters()
    params.RequestedPublishingInterval = asked_ms
    params.RequestedLifetimeCount, params.RequestedMaxKeepAliveCount = 1000, 100
    subscription = await client.create_subscription(params, Ignore())
    granted = await client.uaclient.modify_subscription(
        ua.ModifySubscriptionParameters(SubscriptionId=subscription.subscription_id)
    )
    assert granted.RevisedPublishingInterval == 5.0
    await subscription.delete()


@pytest.mark.parametrize("asked_ms", [10.0, 100.0, 3.6e6, math.inf])
@pytest.mark.parametrize("count", [0, 1, 2**31])
async def test_a_lifetime_is_bounded_in_seconds_whatever_the_interval(
    client: RobotClient, asked_ms: float, count: int
) -> None:
    """Fifteen thousand cycles of an hour were 625 days without a client."""
    params = ua.CreateSubscriptionParameters()
    params.RequestedPublishingInterval = asked_ms
    params.RequestedLifetimeCount = params.RequestedMaxKeepAliveCount = count
    granted = await client.uaclient.create_subscription(params, lambda *_: None)
    cycle_s = granted.RevisedPublishingInterval / 1e3
    assert cycle_s * granted.RevisedMaxKeepAliveCount <= 200.0
    assert cycle_s * granted.RevisedLifetimeCount <= 600.0
    assert granted.RevisedLifetimeCount >= 3 * granted.RevisedMaxKeepAliveCount
    if count == 2**31:
        assert cycle_s * granted.RevisedLifetimeCount > 599.0, (
            "the client gets what there is"
        )
    await client.uaclient.delete_subscriptions([granted.SubscriptionId])


async def test_a_subscription_does_not_outlive_its_client(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscriptions, "LONGEST_PUBLISHING_MS", 20.0)
    async with connected(rig) as orphaning:
        params = ua.CreateSubscriptionParameters(RequestedPublishingInterval=3.6e6)
        params.RequestedLifetimeCount = params.RequestedMaxKeepAliveCount = 2**31
        granted = await orphaning.uaclient.create_subscription(params, lambda *_: None)
        left = rig.server._server.iserver.subscription_service.subscriptions
        assert granted.SubscriptionId in left
        await orphaning.uaclient.close_session(False)
        async with asyncio.timeout(60):
            while granted.SubscriptionId in left:  # noqa: ASYNC110 - nothing announces it
                await asyncio.sleep(0.005)


async def test_queue_size_has_an_upper_bound(client: RobotClient) -> None:
    subscription = await client.create_subscription(100, Ignore())
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor.NodeId = ua.NodeId("pose.x_m", client.index)
    item.ItemToMonitor.AttributeId = ua.AttributeIds.Value
    item.MonitoringMode = ua.MonitoringMode.Reporting
    item.RequestedParameters.QueueSize = 10**9
    params = ua.CreateMonitoredItemsParameters()
    params.SubscriptionId, params.ItemsToCreate = subscription.subscription_id, [item]
    result = (await client.uaclient.create_monitored_items(params))[0]
    assert result.RevisedQueueSize == 1000
    await subscription.delete()


async def test_queue_cannot_be_made_endless_afterwards(client: RobotClient) -> None:
    subscription = await client.create_subscription(100, Ignore())
    handle = await subscription.subscribe_data_change(client.path("pose.x_m"))
    params = ua.ModifyMonitoredItemsParameters()
    params.SubscriptionId = subscription.subscription_id
    for item_id, code in ((handle, "Good"), (999_999, "BadMonitoredItemIdInvalid")):
        request = ua.MonitoredItemModifyRequest()
        request.MonitoredItemId = item_id
        request.RequestedParameters.QueueSize = 0
        params.ItemsToModify.append(request)
        result = (await client.uaclient.modify_monitored_items(params))[-1]
        assert result.StatusCode.name == code
        assert result.RevisedQueueSize == (1 if code == "Good" else 0)
    await subscription.delete()


async def test_nobody_registers_servers_here(client: RobotClient) -> None:
    with pytest.raises(ua.uaerrors.BadServiceUnsupported):
        await client.uaclient.register_server(ua.RegisteredServer())


async def test_client_that_does_not_read_is_closed(
    rig: Rig, client: RobotClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It asks for a megabyte again and again and leaves the answers in the socket."""
    monkeypatch.setattr(transport, "UNREAD_DEADLINE_S", 0.5)
    deaf = RobotClient(rig.server.url)
    await deaf.connect()
    deaf.uaclient.protocol.transport.pause_reading()
    lost = len(rig.server._server.bserver.clients) - 1
    params = ua.BrowseParameters()
    description = ua.BrowseDescription()
    description.NodeId = ua.NodeId(ua.ObjectIds.HierarchicalReferences)
    description.ResultMask = 63
    description.BrowseDirection = ua.BrowseDirection.Both
    params.NodesToBrowse = [description] * 500
    asked = [asyncio.ensure_future(deaf.uaclient.browse(params)) for _ in range(40)]
    async with asyncio.timeout(120):
        while len(rig.server._server.bserver.clients) > lost:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    rig.set("pose.x_m", 4.5)
    assert await client.read("pose.x_m") == 4.5
    for future in asked:
        future.cancel()
    await asyncio.gather(*asked, return_exceptions=True)
    deaf.uaclient.protocol.transport.abort()
    await asyncio.sleep(0)
    await deaf.disconnect()


async def test_sessions_are_limited_and_abandoned_ones_forgotten(
    tmp_path: Path,
) -> None:
    rig = Rig(tmp_path, max_sessions=2)
    await rig.server.start()
    try:
        async with connected(rig), connected(rig):
            late = RobotClient(rig.server.url)
            with pytest.raises(ua.uaerrors.BadTooManySessions):
                await late.connect()
        idle = [RobotClient(rig.server.url) for _ in range(2)]
        for client in idle:
            await client.connect_sessionless()
            await client.create_session()
        sessions = rig.server._server.iserver.sessions
        assert len(sessions) == 2
        for session in sessions.values():
            session.last_active_s -= 60
        async with connected(rig):
            assert len(sessions) == 1
        for client in idle:
            await client.disconnect_sessionless()
    finally:
        await rig.close()


async def test_name_admin_gives_no_rights(rig: Rig) -> None:
    admin = RobotClient(rig.server.url)
    admin.set_user("admin")
    admin.set_password("x")
    with pytest.raises(ua.UaError):
        await admin.connect()


async def test_clients_change_no_nodes(client: RobotClient) -> None:
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await client.path("robot").add_folder(client.index, "Intruder")
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await client.delete_nodes([client.path("pose.x_m")])


async def test_garbage_does_not_disturb_others(rig: Rig, client: RobotClient) -> None:
    for garbage in (
        b"GET / HTTP/1.0\r\n\r\n",
        b"\0" * 64,
        b"HELF" + b"\xff" * 40,
        b"MSGF\x20\0\0\0",
    ):
        _, writer = await asyncio.open_connection(
            "127.0.0.1", int(rig.server.url.split(":")[2].split("/")[0])
        )
        writer.write(garbage)
        await writer.drain()
        writer.close()
        await writer.wait_closed()
    rig.set("pose.x_m", 3.5)
    assert await client.read("pose.x_m") == 3.5


async def test_restart_on_the_same_port_leaves_nothing_behind(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    before = own_tasks()
    await rig.server.start()
    url = rig.server.url
    lost = RobotClient(url)
    await lost.connect()
    subscription = await lost.create_subscription(20, Ignore())
    await subscription.subscribe_data_change(lost.path("pose.x_m"))
    # Gone without a word: its session and subscription outlive the connection.
    lost.uaclient.protocol.transport.abort()
    await asyncio.sleep(0)
    await rig.server.stop()
    await rig.server.stop()
    with pytest.raises((ConnectionError, OSError)):
        await RobotClient(url).connect()
    await lost.disconnect()
    rig.server = rig.make_server(endpoint=url)
    await rig.server.start()
    async with connected(rig) as again:
        rig.set("pose.x_m", 1.0)
        assert await again.read("pose.x_m") == 1.0
    await rig.close()
    async with asyncio.timeout(120):
        while not own_tasks() <= before:  # noqa: ASYNC110 - the client's tasks end by themselves
            await asyncio.sleep(0.01)


async def test_publish_before_start_and_after_stop_is_harmless(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.tick()
    rig.server.publish_diagnostics()
    await rig.server.start()
    await rig.server.stop()
    rig.tick()
    rig.server.publish_diagnostics()
    rig.image.close()


async def test_port_in_use_is_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        rig = Rig(tmp_path, endpoint=f"opc.tcp://127.0.0.1:{port}/hilserver")
        sentence = rf"^opcua.endpoint: .* 127.0.0.1 port {port} \(address already in use\); end the"
        with pytest.raises(FailedError, match=sentence):
            await rig.server.start()
        await rig.close()
    assert "Traceback" not in "".join(capfd.readouterr())


@pytest.mark.parametrize(
    "endpoint",
    [
        "opc.tcp://0.0.0.0:4840/x",
        "opc.tcp://192.0.2.1:4840",
        "opc.tcp://[::]:4840",
        "opc.tcp://host:4840",
    ],
)
async def test_other_addresses_than_loopback_are_refused(endpoint: str) -> None:
    with pytest.raises(ValidationError, match="nobody may log in"):
        OpcUaConfig(endpoint=endpoint)
    assert OpcUaConfig(
        endpoint=endpoint, allow_insecure_network=True
    ).is_open_to_network


@pytest.mark.parametrize(
    "endpoint",
    ["opc.tcp://127.0.0.1:1/x", "opc.tcp://localhost:1", "opc.tcp://[::1]:1"],
)
async def test_loopback_is_allowed(endpoint: str) -> None:
    assert not OpcUaConfig(endpoint=endpoint).is_open_to_network


@pytest.mark.parametrize(
    "endpoint",
    ["http://127.0.0.1:1", "opc.tcp://127.0.0.1", "opc.tcp://127.0.0.1:x", "4840"],
)
async def test_wrong_endpoint_is_one_sentence(endpoint: str) -> None:
    with pytest.raises(ValidationError, match=r"is not an endpoint: write opc\.tcp://"):
        OpcUaConfig(endpoint=endpoint)


async def test_open_server_says_so(tmp_path: Path) -> None:
    rig = Rig(
        tmp_path, endpoint="opc.tcp://0.0.0.0:0/hilserver", allow_insecure_network=True
    )
    with structlog.testing.capture_logs() as logs:
        await rig.server.start()
    assert any(
        entry["log_level"] == "warning" and "open to the network" in entry["event"]
        for entry in logs
    )
    assert rig.server.audit()["opcua_access"]["ok"] is False
    port = rig.server.url.split(":")[2].split("/")[0]
    client = RobotClient(f"opc.tcp://127.0.0.1:{port}/hilserver")
    async with client:
        assert await client.read("audit.opcua_access") is False
    await rig.close()
