"""A hardened server with nodes that asyncua's own interface made."""

import asyncio
import math
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua, uamethod

from hilserver.opcua.passwords import hash_password
from hilserver.opcua.server import HardenedServer
from hilserver.opcua.settings import OpcUaSettings

pytestmark = pytest.mark.asyncio(loop_scope="module")
T = ua.VariantType
CALL = {"*": "engineer", "half": "observer"}


class Tank:
    """A level that is read, a valve that operators write, a list, a method, an event."""

    async def start(self, **settings: Any) -> None:
        endpoint = "opc.tcp://127.0.0.1:0/tank"
        self.server = server = HardenedServer(
            OpcUaSettings(endpoint=endpoint, **settings)
        )
        await server.init()
        self.index = await server.register_namespace("urn:test:tank")
        tank = await server.nodes.objects.add_object(self.id("tank"), "Tank")
        self.level = await tank.add_variable(self.id("level_m"), "level_m", 1.0)
        self.valve = await tank.add_variable(self.id("valve"), "valve", 0.0)
        rates = await tank.add_variable(self.id("rates"), "rates", [1.0, 2.0])
        numbered = await tank.add_variable(ua.NodeId(7, self.index), "numbered", 0)
        for node in (self.valve, rates, numbered):
            await node.set_writable()

        @uamethod
        def half(_parent: object, value: float) -> float:
            if value < 0:
                raise ValueError(value)
            return value / 2

        for name in ("half", "other"):
            await tank.add_method(self.id(name), name, half, [T.Double], [T.Double])
        self.events = await server.get_event_generator(
            emitting_node=ua.ObjectIds.Server
        )
        await server.start()

    def id(self, name: str) -> ua.NodeId:
        return ua.NodeId(name, self.index)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tank() -> AsyncIterator[Tank]:
    tank = Tank()
    await tank.start()
    yield tank
    await tank.server.stop()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(tank: Tank) -> AsyncIterator[Client]:
    async with Client(tank.server.url, timeout=60) as client:
        yield client


async def write(
    client: Client, node_id: ua.NodeId, value: ua.Variant, **item: Any
) -> str:
    params = ua.WriteParameters()
    params.NodesToWrite = [
        ua.WriteValue(node_id, ua.AttributeIds.Value, None, ua.DataValue(value))
    ]
    for name, given in item.items():
        setattr(params.NodesToWrite[0], name, given)
    return (await client.uaclient.write(params))[0].name


async def test_inputs_are_written_and_nothing_else(tank: Tank, client: Client) -> None:
    double, array = ua.Variant(0.5, T.Double), ua.Variant([3.0], T.Double)
    assert await write(client, tank.id("valve"), double) == "Good"
    assert await tank.valve.read_value() == 0.5
    assert await write(client, tank.id("rates"), array) == "Good"
    assert await write(client, tank.id("level_m"), double) == "BadNotWritable"
    assert await write(client, tank.id("none"), double) == "BadNodeIdUnknown"
    assert (
        await write(client, tank.id("valve"), ua.Variant(1, T.Int64))
        == "BadTypeMismatch"
    )
    assert await write(client, tank.id("valve"), array) == "BadTypeMismatch"
    assert await write(client, tank.id("rates"), double) == "BadTypeMismatch"
    assert await write(client, tank.id("valve"), ua.Variant(None)) == "BadTypeMismatch"
    assert (
        await write(client, tank.id("rates"), array, IndexRange="0")
        == "BadWriteNotSupported"
    )
    name = ua.AttributeIds.DisplayName
    assert (
        await write(client, tank.id("valve"), double, AttributeId=name)
        == "BadNotWritable"
    )
    assert await tank.valve.read_value() == 0.5


async def call(
    client: Client, tank: Tank, name: str, *arguments: ua.Variant, on: str = "tank"
) -> Any:
    request = ua.CallMethodRequest(tank.id(on), tank.id(name), list(arguments))
    return (await client.uaclient.call([request]))[0]


async def test_arguments_are_checked_before_the_function_runs(
    tank: Tank, client: Client
) -> None:
    two = ua.Variant(2.0, T.Double)
    done = await call(client, tank, "half", two)
    assert (done.StatusCode.name, done.OutputArguments[0].Value) == ("Good", 1.0)
    for arguments, code in (
        ((), "BadArgumentsMissing"),
        ((two, two), "BadTooManyArguments"),
        ((ua.Variant(2, T.Int64),), "BadInvalidArgument"),
        ((ua.Variant([2.0], T.Double),), "BadInvalidArgument"),
        ((ua.Variant(None, T.Null),), "BadInvalidArgument"),
        ((ua.Variant(-1.0, T.Double),), "BadUnexpectedError"),
    ):
        assert (await call(client, tank, "half", *arguments)).StatusCode.name == code
    assert (
        await call(client, tank, "half", two, on="valve")
    ).StatusCode.name == "BadMethodInvalid"
    assert (await call(client, tank, "none", two)).StatusCode.name == "BadMethodInvalid"


class Notes:
    def __init__(self) -> None:
        self.values: list[Any] = []

    def datachange_notification(
        self, node: object, value: object, data: object
    ) -> None:
        self.values.append(value)

    def event_notification(self, event: Any) -> None:
        self.values.append(event.Message.Text)

    async def until(self, is_done: Callable[[list[Any]], bool]) -> list[Any]:
        async with asyncio.timeout(60):
            while not is_done(self.values):  # noqa: ASYNC110 - of another library
                await asyncio.sleep(0.01)
        return self.values


async def test_a_queue_holds_every_value_that_was_sampled(
    tank: Tank, client: Client
) -> None:
    notes = Notes()
    subscription = await client.create_subscription(200, notes)
    await subscription.subscribe_data_change(
        client.get_node(tank.id("level_m")), queuesize=10, sampling_interval=0
    )
    await notes.until(bool)
    for value in (3.0, 4.0, 5.0):
        await tank.level.write_value(value)
        tank.server.sample()
        await asyncio.sleep(0.01)
    assert (await notes.until(lambda values: 5.0 in values))[1:] == [3.0, 4.0, 5.0]


async def test_events_of_asyncua_s_generators_arrive(
    tank: Tank, client: Client
) -> None:
    notes = Notes()
    subscription = await client.create_subscription(20, notes)
    await subscription.subscribe_events()
    await tank.events.trigger(message="overflow")
    assert await notes.until(bool) == ["overflow"]


async def test_time_is_live_and_no_limit_is_missing(client: Client) -> None:
    now = client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime)
    assert await now.read_value() < await now.read_value()
    limit = ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
    assert await client.get_node(limit).read_value() == 1000


async def test_roles_go_by_the_names_of_nodes() -> None:
    tank = Tank()
    write_by = {"*": "engineer", "valve": "observer", "numbered": "observer"}
    await tank.start(
        anonymous="observer", permissions={"write": write_by, "call": CALL}
    )
    try:
        async with Client(tank.server.url, timeout=60) as client:
            double = ua.Variant(0.5, T.Double)
            assert await write(client, tank.id("valve"), double) == "Good"
            assert (
                await write(client, ua.NodeId(7, tank.index), ua.Variant(1, T.Int64))
                == "Good"
            )
            array = ua.Variant([math.nan], T.Double)
            assert await write(client, tank.id("rates"), array) == "BadUserAccessDenied"
            assert (await call(client, tank, "half", double)).StatusCode.name == "Good"
            denied = (await call(client, tank, "other", double)).StatusCode.name
            assert denied == "BadUserAccessDenied"
            for name, may in (("valve", True), ("rates", False)):
                level = await client.get_node(tank.id(name)).get_user_access_level()
                assert (ua.AccessLevel.CurrentWrite in level) == may
    finally:
        await tank.server.stop()


async def test_beyond_loopback_nobody_comes_in_without_password_and_key(
    tmp_path: Path,
) -> None:
    endpoint = "opc.tcp://192.0.2.7:4841/tank"
    with pytest.raises(ValueError, match="nobody may log in"):
        OpcUaSettings(endpoint=endpoint)
    users = [{"name": "otto", "password": hash_password("secret")}]
    settings = OpcUaSettings(endpoint=endpoint, users=users)
    with pytest.raises(Exception, match="make a certificate with"):
        HardenedServer(settings, tmp_path)


_LOADED = """
import sys
import hilserver.opcua.server
rooms = {name.split(".")[1] for name in sys.modules if name.startswith("hilserver.")}
print(*sorted(rooms | ({"numba"} & set(sys.modules))))
"""


async def test_it_knows_no_robot_and_compiles_nothing() -> None:
    done = await asyncio.to_thread(
        subprocess.run, [sys.executable, "-c", _LOADED], capture_output=True, text=True
    )
    assert done.stdout.split() == ["cache", "errors", "opcua", "period", "small_file"]
