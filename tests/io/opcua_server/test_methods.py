"""Methods: what they do to the daemon, and what they answer."""

import asyncio
import math
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from asyncua import ua

from hilserver.opcua import processor
from hilserver.signals import State
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")
T = ua.VariantType


def text(value: str) -> ua.Variant:
    return ua.Variant(value, T.String)


def double(value: float) -> ua.Variant:
    return ua.Variant(value, T.Double)


@pytest.fixture(autouse=True)
def running(rig: Rig) -> Iterator[None]:
    rig.control.started()
    yield
    if rig.control.state is State.SAFE:
        rig.control.reset()
    if rig.control.state is State.PAUSED:
        rig.control.start()
    rig.tick()


async def code(client: RobotClient, name: str, *arguments: ua.Variant) -> str:
    return (await client.call(name, *arguments)).StatusCode.name


async def test_pause_step_start(rig: Rig, client: RobotClient) -> None:
    rig.pacing.calls.clear()
    assert await code(client, "Pause") == "Good"
    assert rig.control.state is State.PAUSED
    assert await code(client, "Step", ua.Variant(7, T.UInt32)) == "Good"
    assert await code(client, "Start") == "Good"
    assert await code(client, "ResetStatistics") == "Good"
    assert rig.pacing.calls == ["pause", "step 7", "resume", "reset_statistics"]
    rig.tick()
    assert await client.read("sim.state") == State.RUNNING


async def test_stop_is_the_safe_state_and_reset_ends_it(
    rig: Rig, client: RobotClient
) -> None:
    assert await code(client, "Stop") == "Good"
    rig.tick()
    assert await client.read("sim.state") == State.SAFE
    assert await code(client, "Start") == "BadInvalidState"
    assert await code(client, "Reset") == "Good"
    rig.tick()
    assert await client.read("sim.state") == State.RUNNING


async def test_not_possible_now(rig: Rig, client: RobotClient) -> None:
    assert await code(client, "Step", ua.Variant(1, T.UInt32)) == "BadInvalidState"
    rig.control.enter_safe("test", cause="cable")
    assert await code(client, "Reset") == "BadInvalidState"
    rig.control.clear_cause("cable")


async def test_set_pose(rig: Rig, client: RobotClient) -> None:
    assert (
        await code(client, "SetPose", double(1.5), double(-2.0), double(0.5)) == "Good"
    )
    rig.tick()
    values, slot = rig.image.latest().values, rig.table.slot
    names = ("internal.pose_x_m", "internal.pose_y_m", "internal.pose_yaw_rad")
    assert [values[slot(name)] for name in names] == [1.5, -2.0, 0.5]
    assert values[slot("internal.pose_request")] >= 1


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        ("Step", [], "BadArgumentsMissing"),
        ("Start", [text("x")], "BadTooManyArguments"),
        ("Step", [ua.Variant(1, T.Int64)], "BadInvalidArgument"),
        ("Step", [ua.Variant([1], T.UInt32)], "BadInvalidArgument"),
        ("SetPose", [double(0), double(0), double(math.nan)], "BadInvalidArgument"),
        ("SetPose", [double(math.inf), double(0), double(0)], "BadInvalidArgument"),
        ("SetPose", [double(0), double(0), double(4.0)], "BadInvalidArgument"),
        ("SaveSnapshot", [text("../x")], "BadInvalidArgument"),
        ("SaveSnapshot", [text("/etc/x")], "BadInvalidArgument"),
        ("LoadSnapshot", [text("..")], "BadInvalidArgument"),
        ("LoadSnapshot", [text("")], "BadInvalidArgument"),
        ("LoadSnapshot", [ua.Variant(None, T.String)], "BadInvalidArgument"),
        ("LoadSnapshot", [text("never_saved")], "BadInvalidState"),
        ("Force", [text("pose.x_m"), double(1.0)], "BadNotImplemented"),
        ("Unforce", [text("pose.x_m")], "BadNotImplemented"),
        ("InjectFault", [text("{}")], "BadNotImplemented"),
        ("ClearFaults", [], "BadNotImplemented"),
    ],
)
async def test_refused_calls(
    client: RobotClient, name: str, arguments: list[ua.Variant], expected: str
) -> None:
    assert await code(client, name, *arguments) == expected


async def test_wrong_argument_is_pointed_at(client: RobotClient) -> None:
    result = await client.call("SetPose", double(0), text("0"), double(0))
    assert [r.name for r in result.InputArgumentResults] == [
        "Good",
        "BadTypeMismatch",
        "Good",
    ]


async def test_method_of_another_object(client: RobotClient) -> None:
    request = ua.CallMethodRequest()
    request.ObjectId = ua.NodeId("robot", client.index)
    request.MethodId = ua.NodeId("methods.Pause", client.index)
    assert (await client.uaclient.call([request]))[
        0
    ].StatusCode.name == "BadMethodInvalid"
    request.MethodId = ua.NodeId("methods.Explode", client.index)
    assert (await client.uaclient.call([request]))[
        0
    ].StatusCode.name == "BadMethodInvalid"


async def test_snapshot_is_saved_and_restored(rig: Rig, client: RobotClient) -> None:
    tick = rig.pacing.tick
    stop = asyncio.Event()

    async def plant() -> None:
        while not stop.is_set():
            rig.tick()
            await asyncio.sleep(0)

    running = asyncio.create_task(plant())
    try:
        assert await code(client, "SaveSnapshot", text("here")) == "Good"
        saved_before = rig.pacing.tick
        rig.tick(n=500)
        assert await code(client, "LoadSnapshot", text("here")) == "Good"
        assert tick < rig.pacing.tick < saved_before + 500
    finally:
        stop.set()
        await running


async def test_asyncua_call_method_works_too(rig: Rig, client: RobotClient) -> None:
    methods = client.path("methods")
    await methods.call_method(f"{client.index}:Pause")
    assert rig.control.state is State.PAUSED
    with pytest.raises(ua.uaerrors.BadNotImplemented):
        await methods.call_method(f"{client.index}:ClearFaults")


async def test_one_call_does_not_wait_for_ever(
    rig: Rig, client: RobotClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand methods that each wait for the plant: those behind the limit are not called."""
    monkeypatch.setattr(processor, "LONGEST_WAIT_S", 0.05)
    called = []

    async def wait(request: object, user: object) -> tuple[ua.CallMethodResult, str]:
        called.append(request)
        await asyncio.sleep(0.06)
        return ua.CallMethodResult(), ""

    monkeypatch.setattr(rig.server._server.application, "call", wait)
    request = ua.CallMethodRequest(
        ua.NodeId("methods", client.index), ua.NodeId("methods.Step", client.index)
    )
    results = await client.uaclient.call([request] * 5)
    assert [result.StatusCode.name for result in results] == [
        "Good",
        *["BadTimeout"] * 4,
    ]
    assert len(called) == 1


async def test_a_call_whose_caller_was_told_that_it_failed_is_not_carried_out(
    rig: Rig, client: RobotClient
) -> None:
    """Before, what was pressed while the daemon stood still was done long afterwards."""
    rig.pacing.calls.clear()
    answers = [await late(client, seconds) for seconds in (1.0, 7.0, 3600.0)]
    assert answers == ["Good", "BadTimeout", "Good"]  # an hour: it gives local time
    assert rig.pacing.calls.count("pause") == 2


async def late(client: RobotClient, seconds: float) -> str:
    """Call Pause as a client that has waited so long, and waits 5 s for answers."""
    item = ua.CallMethodRequest()
    item.ObjectId = ua.NodeId("methods", client.index)
    item.MethodId = ua.NodeId("methods.Pause", client.index)
    request = ua.CallRequest()
    request.RequestHeader.Timestamp = datetime.now(UTC) - timedelta(seconds=seconds)
    request.Parameters.MethodsToCall = [item]
    try:
        await client.uaclient.protocol.send_request(request, timeout=5)
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    return "Good"
