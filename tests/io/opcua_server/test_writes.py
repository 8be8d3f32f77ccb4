"""Inputs: what is accepted, what is refused, with which code, and what reaches the plant."""

import math
import socket
import time

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.core.events import EventKind
from hilserver.io.opcua_server.model import SHELL
from hilserver.plant.layout import WHEELS
from tests.io.opcua_server.rig import Rig, RobotClient, connected
from tests.loopback.rig import wait_until

pytestmark = pytest.mark.asyncio(loop_scope="module")
T = ua.VariantType
FL, ARRAY = "wheel.fl.setpoint_rpm", "wheels.setpoints_rpm"


@pytest_asyncio.fixture(autouse=True, loop_scope="module")
async def in_control(rig: Rig) -> None:
    rig.gate.take("opcua")
    rig.tick()


def latched(rig: Rig, name: str) -> float:
    rig.tick()
    return float(rig.image.latest().values[rig.table.slot(name)])


async def test_accepted_write_reaches_the_plant_and_is_read_back(
    rig: Rig, client: RobotClient
) -> None:
    assert await client.write((FL, 33.5, T.Double)) == ["Good"]
    assert await client.read(FL) == 33.5
    assert (await client.read(ARRAY))[0] == 33.5
    assert latched(rig, FL) == 33.5
    assert await client.read("wheel.fl.speed_rpm") == 33.5


async def test_all_types(rig: Rig, client: RobotClient) -> None:
    answers = await client.write(
        ("control.mode", 1, T.Byte),
        ("drive.enable", False, T.Boolean),
        ("input.sequence", 4_000_000_000, T.UInt32),
        ("twist.linear_m_s", -0.25, T.Double),
    )
    assert answers == ["Good"] * 4
    assert latched(rig, "input.sequence") == 4e9
    assert (await client.read("drive.enable"), await client.read("control.mode")) == (
        False,
        1,
    )


async def test_array_write_maps_to_four_slots_and_later_wins(
    rig: Rig, client: RobotClient
) -> None:
    four = [1.0, 2.0, -3.0, -4.0]
    assert await client.write((ARRAY, four, T.Double), (FL, 9.0, T.Double)) == [
        "Good",
        "Good",
    ]
    assert await client.read(ARRAY) == [9.0, 2.0, -3.0, -4.0]
    assert latched(rig, FL) == 9.0
    assert await client.write((FL, 8.0, T.Double), (ARRAY, four, T.Double)) == [
        "Good",
        "Good",
    ]
    assert latched(rig, FL) == 1.0
    assert await client.write((FL, 5.0, T.Double), (FL, 6.0, T.Double)) == [
        "Good",
        "Good",
    ]
    assert latched(rig, FL) == 6.0


@pytest.mark.parametrize(
    ("path", "value", "kind", "code"),
    [
        (FL, 90.1, T.Double, "BadOutOfRange"),
        (FL, math.nan, T.Double, "BadOutOfRange"),
        (FL, math.inf, T.Double, "BadOutOfRange"),
        (FL, -math.inf, T.Double, "BadOutOfRange"),
        (FL, 5, T.Int64, "BadTypeMismatch"),
        (FL, 5.0, T.Float, "BadTypeMismatch"),
        (FL, "5", T.String, "BadTypeMismatch"),
        (FL, [1.0], T.Double, "BadTypeMismatch"),
        (FL, None, T.Null, "BadTypeMismatch"),
        (ARRAY, [1.0, 2.0, 3.0], T.Double, "BadTypeMismatch"),
        (ARRAY, 1.0, T.Double, "BadTypeMismatch"),
        (ARRAY, [1.0, 2.0, 3.0, math.nan], T.Double, "BadOutOfRange"),
        (ARRAY, [1.0, 2.0, 3.0, 91.0], T.Double, "BadOutOfRange"),
        (ARRAY, [[1.0, 2.0], [3.0, 4.0]], T.Double, "BadTypeMismatch"),
        ("drive.enable", 1, T.Byte, "BadTypeMismatch"),
        ("control.mode", 3, T.Byte, "BadOutOfRange"),
        ("lights.command", 9, T.Byte, "BadOutOfRange"),
        ("pose.x_m", 1.0, T.Double, "BadNotWritable"),
        ("slices", 1.0, T.Double, "BadAttributeIdInvalid"),
        ("internal.command", 1.0, T.Double, "BadNodeIdUnknown"),
        ("no.such_signal", 1.0, T.Double, "BadNodeIdUnknown"),
        ("control.source", 1.0, T.Double, "BadTypeMismatch"),
        ("control.source", "somebody", T.String, "BadOutOfRange"),
    ],
)
async def test_refused_writes_name_their_reason_and_change_nothing(
    rig: Rig, client: RobotClient, path: str, value: object, kind: T, code: str
) -> None:
    await client.write((ARRAY, [1.0] * 4, T.Double), ("lights.command", 0, T.Byte))
    rig.tick()
    before = rig.image.latest().values.copy()
    assert await client.write((path, value, kind)) == [code]
    rig.tick()
    same = rig.image.latest().values == before
    for name in ("sim.tick", "sim.time_s"):
        same[rig.table.slot(name)] = True
    assert same.all()


async def test_refusals_are_counted_and_published(
    rig: Rig, client: RobotClient
) -> None:
    rig.gate.rejected.clear()
    await client.write((FL, 5, T.Int64), (FL, 91.0, T.Double), (FL, math.nan, T.Double))
    reasons = {
        reason: n
        for (source, reason), n in rig.gate.rejected.items()
        if source == "opcua"
    }
    assert reasons == {"type_mismatch": 1, "out_of_range": 1, "not_finite": 1}
    kinds = [event.kind for event in rig.events.recent][-3:]
    assert kinds == [EventKind.SETPOINT_REFUSED] * 3
    text = "wheel.fl.setpoint_rpm = '5 of type Int64' refused: a value of type Double expected"
    assert rig.events.recent[-3].message == f"opcua: {text}"


WHEELS_RPM = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (("wheel.rr.setpoint_rpm", math.nan, T.Double), "BadOutOfRange"),
        (("wheel.rr.setpoint_rpm", 400.0, T.Double), "BadOutOfRange"),
        (("wheel.rr.setpoint_rpm", 5.0, T.Float), "BadTypeMismatch"),
        ((ARRAY, [1.0, 2.0, 3.0], T.Double), "BadTypeMismatch"),
        (("wheel.rx.setpoint_rpm", 5.0, T.Double), "BadNodeIdUnknown"),
        (("control.mode", 7, T.Byte), "BadOutOfRange"),
    ],
)
@pytest.mark.parametrize("place", [0, 1, 3])
async def test_a_command_is_whole_or_not_at_all(
    rig: Rig, client: RobotClient, wrong: tuple[str, object, T], code: str, place: int
) -> None:
    assert await client.write((ARRAY, [1.0] * 4, T.Double)) == ["Good"]
    items = [(name, 4.0, T.Double) for name in WHEELS_RPM[:3]]
    items.insert(place, wrong)
    answers = await client.write(*items)
    assert answers.pop(place) == code
    assert answers == ["BadInvalidState"] * 3
    assert latched(rig, FL) == 1.0
    assert await client.read(ARRAY) == [1.0] * 4


async def test_a_wrong_value_spoils_its_command_across_the_request(
    rig: Rig, client: RobotClient
) -> None:
    await client.write((ARRAY, [1.0] * 4, T.Double))
    answers = await client.write(
        (FL, 2.0, T.Double),
        (FL, 3.0, T.Double),
        ("control.source", "opcua", T.String),
        ("wheel.fr.setpoint_rpm", math.nan, T.Double),
        ("twist.linear_m_s", 0.1, T.Double),
        ("measured.pose.x_m", 2.5, T.Double),
    )
    assert answers == [
        *("BadInvalidState", "BadInvalidState", "Good", "BadOutOfRange"),
        *("Good", "Good"),
    ]
    assert latched(rig, FL) == 0.0, "taking control has ended what was commanded"
    assert latched(rig, "twist.linear_m_s") == 0.1


async def test_without_control_nothing_but_measured_values(
    rig: Rig, client: RobotClient
) -> None:
    rig.gate.take("peer")
    rig.tick()
    assert await client.read("control.source") == "peer"
    assert await client.write((FL, 1.0, T.Double)) == ["BadUserAccessDenied"]
    assert "'peer' has control" in rig.events.recent[-1].message
    assert await client.write(("measured.pose.x_m", 1.25, T.Double)) == ["Good"]
    assert latched(rig, "measured.pose.x_m") == 1.25


async def test_taking_control_acts_on_the_writes_behind_it(
    rig: Rig, client: RobotClient
) -> None:
    rig.gate.take("peer")
    answers = await client.write(
        (FL, 1.0, T.Double), ("control.source", "opcua", T.String), (FL, 2.0, T.Double)
    )
    assert answers == ["BadUserAccessDenied", "Good", "Good"]
    assert rig.gate.owner == "opcua"
    assert latched(rig, FL) == 2.0
    assert await client.read("control.source") == "opcua"
    assert await client.write(("control.source", "peer", T.String)) == ["Good"]
    assert rig.gate.owner == "peer"


async def test_what_a_client_commands_ends_with_it_though_it_took_no_control(
    rig: Rig, client: RobotClient
) -> None:
    killed = RobotClient(rig.server.url)
    await killed.connect()
    assert await killed.write((FL, 20.0, T.Double)) == ["Good"]
    assert latched(rig, FL) == 20.0
    async with connected(rig) as watcher:
        assert await watcher.write(("lights.command", 1, T.Byte)) == ["Good"]
    assert latched(rig, FL) == 20.0, "only who set the set-points ends them"
    killed.uaclient.protocol.transport.abort()
    await wait_until(lambda: latched(rig, FL) == 0.0)
    assert (
        rig.events.recent[-1].message
        == "a client of 'opcua' is gone: its set-points are zero"
    )
    assert rig.gate.owner == "opcua"
    assert await client.write((FL, 5.0, T.Double)) == ["Good"]
    assert latched(rig, FL) == 5.0


async def test_of_several_clients_only_what_one_set_last_ends_with_it(
    rig: Rig, client: RobotClient
) -> None:
    killed = RobotClient(rig.server.url)
    await killed.connect()
    wheels = [f"wheel.{w}.setpoint_rpm" for w in WHEELS]
    enable = "drive.enable"
    assert (
        await killed.write(*((name, 20.0, T.Double) for name in wheels)) == ["Good"] * 4
    )
    answers = await client.write((wheels[1], 7.0, T.Double), (enable, False, T.Boolean))
    assert answers == ["Good"] * 2
    shell = RobotClient(rig.server.url)
    shell.description = SHELL
    async with shell:
        shell.index = client.index
        assert await shell.write((wheels[2], 9.0, T.Double)) == ["Good"]
    killed.uaclient.protocol.transport.abort()
    await wait_until(lambda: latched(rig, wheels[0]) == 0.0)
    assert [latched(rig, name) for name in wheels] == [0.0, 7.0, 9.0, 0.0]
    assert latched(rig, enable) == 0.0, "whoever switched the drive off is still there"


async def test_what_the_shell_commands_holds_when_its_session_ends(
    rig: Rig, client: RobotClient
) -> None:
    assert await client.write((FL, 5.0, T.Double)) == ["Good"]
    shell = RobotClient(rig.server.url)
    shell.description = SHELL
    async with shell:
        shell.index = client.index
        assert await shell.write((FL, 20.0, T.Double)) == ["Good"]
    async with connected(rig) as another:
        assert await another.write(("lights.command", 1, T.Byte)) == ["Good"]
    assert latched(rig, FL) == 20.0


async def test_a_higher_source_keeps_control(rig: Rig, client: RobotClient) -> None:
    rig.gate.take("page")
    assert await client.write(("control.source", "opcua", T.String)) == [
        "BadUserAccessDenied"
    ]
    assert rig.gate.owner == "page"


async def test_only_plain_good_values(rig: Rig, client: RobotClient) -> None:
    item = ua.WriteValue()
    item.NodeId, item.AttributeId = ua.NodeId(FL, client.index), ua.AttributeIds.Value
    refused = "BadWriteNotSupported"
    number = ua.Variant(1.0, T.Double)
    for value, index_range, code in (
        (ua.DataValue(number, ua.StatusCode(ua.StatusCodes.BadNoData)), None, refused),
        (ua.DataValue(number, ua.StatusCode(0x40000000)), None, refused),
        (ua.DataValue(number), "0:1", refused),
        (ua.DataValue(number), None, "Good"),
    ):
        item.Value, item.IndexRange = value, index_range
        params = ua.WriteParameters()
        params.NodesToWrite = [item]
        assert [c.name for c in await client.uaclient.write(params)] == [code]


async def test_other_attributes_and_other_namespaces_are_read_only(
    client: RobotClient,
) -> None:
    for node_id, attribute in (
        (ua.NodeId(FL, client.index), ua.AttributeIds.DisplayName),
        (ua.NodeId(FL, client.index), ua.AttributeIds.AccessLevel),
        (ua.NodeId(ua.ObjectIds.Server_ServiceLevel), ua.AttributeIds.Value),
        (ua.NodeId(ua.ObjectIds.Server_NamespaceArray), ua.AttributeIds.Value),
    ):
        params = ua.WriteParameters()
        item = ua.WriteValue()
        item.NodeId, item.AttributeId = node_id, attribute
        item.Value = ua.DataValue(ua.Variant(3, T.Byte))
        params.NodesToWrite = [item]
        assert [c.name for c in await client.uaclient.write(params)] == [
            "BadNotWritable"
        ]


async def test_full_queue_is_refused(rig: Rig, client: RobotClient) -> None:
    answers = [(await client.write((ARRAY, [1.0] * 4, T.Double)))[0] for _ in range(65)]
    assert answers == ["Good"] * 64 + ["BadResourceUnavailable"]
    rig.tick()
    assert await client.write((FL, 2.0, T.Double)) == ["Good"]


async def test_reason_in_words_for_clients_that_ask(
    rig: Rig, client: RobotClient
) -> None:
    rig.gate.take("peer")
    request = ua.WriteRequest()
    request.RequestHeader.ReturnDiagnostics = 0xC0
    item = ua.WriteValue()
    item.NodeId, item.AttributeId = ua.NodeId(FL, client.index), ua.AttributeIds.Value
    item.Value = ua.DataValue(ua.Variant(1.0, T.Double))
    request.Parameters.NodesToWrite = [item]
    data = await client.uaclient.protocol.send_request(request)
    response = ua.ua_binary.struct_from_binary(ua.WriteResponse, data)
    info = response.DiagnosticInfos[0]
    assert "'peer' has control" in info.AdditionalInfo
    assert (
        response.ResponseHeader.StringTable[info.LocalizedText] == info.AdditionalInfo
    )


class SendsAndStands:
    """A transport that stops the event loop as soon as a request is on its way."""

    def __init__(self, transport, seconds):
        self._transport, self._seconds, self.sent_ns = transport, seconds, 0

    def __getattr__(self, name):
        return getattr(self._transport, name)

    def write(self, data):
        fd = self._transport.get_extra_info("socket").fileno()
        connection = socket.socket(fileno=fd)
        connection.send(data)
        connection.detach()
        self.sent_ns = time.monotonic_ns()
        time.sleep(self._seconds)


async def test_a_command_that_waited_for_our_event_loop_came_in_when_it_was_sent(
    rig: Rig, client: RobotClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    stands_s, came, write = 1.0, [], rig.gate.write
    protocol = client.uaclient.protocol
    stands = SendsAndStands(protocol.transport, stands_s)

    def noting(source, values, *, received_ns, **more):
        came.append(received_ns)
        return write(source, values, received_ns=received_ns, **more)

    monkeypatch.setattr(rig.gate, "write", noting)
    monkeypatch.setattr(protocol, "transport", stands)
    assert await client.write((FL, 30.0, T.Double)) == ["Good"]
    assert came[0] < stands.sent_ns + stands_s / 2 * 1e9
    monkeypatch.undo()
    assert await client.write((FL, 31.0, T.Double)) == ["Good"]
