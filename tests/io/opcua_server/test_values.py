"""Outputs: what is published, with which status and stamp, and to whom."""

import asyncio
import copy
import math
import time
from datetime import UTC, datetime

import numpy as np
import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.clock import UtcClock
from hilserver.image import Frame
from hilserver.io.opcua_server.values import SignalPlace, SignalVariables, worst
from hilserver.opcua.encoding import FixedDataValue
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD, UNCERTAIN
from tests.io.opcua_server.rig import TABLE, Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")


def bare() -> tuple[SignalVariables, dict[str, SignalPlace]]:
    variables = SignalVariables(TABLE, UtcClock())
    return variables, variables.places


def frame(
    values: dict[str, float] | None = None,
    status: dict[str, int] | None = None,
    latched: int = 0,
) -> Frame:
    numbers, codes = np.zeros(TABLE.n_slots), np.zeros(TABLE.n_slots, dtype=np.int64)
    for name, value in (values or {}).items():
        numbers[TABLE.slot(name)] = value
    for name, code in (status or {}).items():
        codes[TABLE.slot(name)] = code
    return Frame(0, 1, time.monotonic_ns(), latched, numbers, codes)


async def test_first_frame_ends_the_waiting(rig: Rig, client: RobotClient) -> None:
    before = await client.data_value("pose.x_m")
    assert before.StatusCode.name == "BadWaitingForInitialData"
    rig.set("pose.x_m", 1.5)
    after = await client.data_value("pose.x_m")
    assert (after.StatusCode.name, after.Value.Value) == ("Good", 1.5)
    assert (await client.data_value("drive.enable")).Value.Value is True


async def test_stamp_is_that_of_the_tick(rig: Rig, client: RobotClient) -> None:
    rig.set("pose.x_m", 2.5)
    frame = rig.image.latest()
    stamp = (await client.data_value("pose.x_m")).SourceTimestamp
    assert stamp == rig.clock.utc(frame.planned_ns)
    rig.set("pose.y_m", 1.0)
    assert (await client.data_value("pose.x_m")).SourceTimestamp == stamp
    assert (await client.data_value("sim.tick")).SourceTimestamp > stamp


async def test_types_and_arrays(rig: Rig, client: RobotClient) -> None:
    rig.gate.write("peer:a", {"wheel.rl.setpoint_rpm": 12.0})
    rig.tick()
    speeds = (await client.data_value("wheels.speeds_rpm")).Value
    assert (speeds.Value, speeds.VariantType) == (
        [0.0, 12.0, 0.0, 0.0],
        ua.VariantType.Double,
    )
    tick = (await client.data_value("sim.tick")).Value
    assert (tick.Value, tick.VariantType) == (rig.pacing.tick, ua.VariantType.Int64)
    assert (
        await client.data_value("sim.state")
    ).Value.VariantType == ua.VariantType.Byte


async def test_status_codes_travel(rig: Rig, client: RobotClient) -> None:
    rig.set("nav.x_m", 0.0, BAD_OUT_OF_SERVICE)
    value = await client.data_value("nav.x_m")
    assert (value.StatusCode.name, value.Value.Value) == ("BadOutOfService", None)
    rig.set("wheel.fl.speed_rpm", 3.0, UNCERTAIN)
    value = await client.data_value("wheel.fl.speed_rpm")
    assert (value.StatusCode.name, value.Value.Value) == ("Uncertain", 3.0)
    assert (await client.data_value("wheels.speeds_rpm")).StatusCode.name == "Uncertain"
    rig.set("nav.x_m", 4.0, GOOD)
    assert await client.read("nav.x_m") == 4.0


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
async def test_no_number_is_never_good(
    rig: Rig, client: RobotClient, number: float
) -> None:
    rig.set("pose.yaw_rad", number)
    value = await client.data_value("pose.yaw_rad")
    assert (value.StatusCode.name, value.Value.Value) == ("BadSensorFailure", None)
    rig.set("pose.yaw_rad", 0.25)
    assert await client.read("pose.yaw_rad") == 0.25


async def test_subscribers_get_every_change(rig: Rig, client: RobotClient) -> None:
    received: list[float] = []
    done = asyncio.Event()

    class Handler:
        def datachange_notification(
            self, node: object, value: float, data: object
        ) -> None:
            received.append(value)
            if value == 5.0:
                done.set()

    rig.set("battery.voltage_v", 0.5)
    subscription = await client.create_subscription(10, Handler())
    await subscription.subscribe_data_change(
        client.path("battery.voltage_v"), queuesize=10, sampling_interval=0
    )
    for volts in (1.0, 2.0, 2.0, 3.0, 5.0):
        rig.set("battery.voltage_v", volts)
    await asyncio.wait_for(done.wait(), 60)
    await subscription.delete()
    assert received == [0.5, 1.0, 2.0, 3.0, 5.0]


async def test_dead_band_does_not_swallow_a_bad_status(
    rig: Rig, client: RobotClient
) -> None:
    codes: asyncio.Queue[str] = asyncio.Queue()

    class Handler:
        def datachange_notification(
            self, node: object, value: object, data: object
        ) -> None:
            codes.put_nowait(data.monitored_item.Value.StatusCode.name)

    rig.set("tof.fl_m", 1.0)
    subscription = await client.create_subscription(10, Handler())
    await subscription.deadband_monitor(client.path("tof.fl_m"), deadband_val=0.5)
    assert await asyncio.wait_for(codes.get(), 60) == "Good"
    rig.set("tof.fl_m", 1.0, BAD_OUT_OF_SERVICE)
    assert await asyncio.wait_for(codes.get(), 60) == "BadOutOfService"
    await subscription.delete()


async def test_made_once_per_change_and_only_when_somebody_looks() -> None:
    variables, places = bare()
    assert variables.publish(frame()) == TABLE.n_slots
    assert variables.publish(frame()) == 0
    still, speed = places["pose.x_m"].value, places["wheel.fl.speed_rpm"].value
    assert variables.publish(frame({"wheel.fl.speed_rpm": 1.0})) == 1
    assert places["pose.x_m"].value is still
    assert places["wheel.fl.speed_rpm"].value is not speed
    assert places["wheels.speeds_rpm"].value.Value.Value[1] == 0.0
    uncertain = frame({"wheel.fl.speed_rpm": 1.0}, {"wheel.fl.speed_rpm": UNCERTAIN})
    assert variables.publish(uncertain) == 1
    assert variables.publish(uncertain) == 0
    made = places["wheel.fl.speed_rpm"].value
    assert made.encoded(ua.TimestampsToReturn.Both) is made.encoded(
        ua.TimestampsToReturn.Both
    )


@given(st.lists(st.lists(st.floats(), min_size=4, max_size=4), min_size=1, max_size=6))
async def test_published_bits_are_the_frames_bits(rows: list[list[float]]) -> None:
    variables, places = bare()
    names = ["pose.x_m", "pose.y_m", "nav.x_m", "battery.voltage_v"]
    for row in rows:
        variables.publish(frame(dict(zip(names, row, strict=True))))
        for name, number in zip(names, row, strict=True):
            shown = places[name].value
            if math.isfinite(number):
                assert (
                    np.float64(shown.Value.Value).tobytes()
                    == np.float64(number).tobytes()
                )
            else:
                assert shown.StatusCode.is_bad()


async def test_what_was_written_stays_until_a_frame_contains_it() -> None:
    variables, places = bare()
    place = places["wheel.fl.setpoint_rpm"]
    variables.publish(frame(latched=5))
    variables.show_written({"wheel.fl.setpoint_rpm": (7.0,)}, pushed_rows=6)
    assert (
        place.value.Value.Value,
        places["wheels.setpoints_rpm"].value.Value.Value[0],
    ) == (
        7.0,
        7.0,
    )
    variables.publish(frame({"wheel.fl.setpoint_rpm": 3.0}, latched=5))
    assert place.value.Value.Value == 7.0
    shown_at = place.value.SourceTimestamp
    variables.publish(frame({"wheel.fl.setpoint_rpm": 7.0}, latched=6))
    assert place.value.Value.Value == 7.0
    assert place.value.SourceTimestamp != shown_at
    variables.publish(frame({"wheel.fl.setpoint_rpm": 1.0}, latched=6))
    assert place.value.Value.Value == 1.0


_SCALARS = st.one_of(
    st.tuples(st.just(ua.VariantType.Double), st.floats()),
    st.tuples(st.just(ua.VariantType.Boolean), st.booleans()),
    st.tuples(st.just(ua.VariantType.Byte), st.integers(0, 255)),
    st.tuples(st.just(ua.VariantType.UInt32), st.integers(0, 2**32 - 1)),
    st.tuples(st.just(ua.VariantType.Int64), st.integers(-(2**63), 2**63 - 1)),
    st.tuples(st.just(ua.VariantType.String), st.text()),
    st.tuples(st.just(ua.VariantType.Double), st.lists(st.floats(), max_size=5)),
)


@given(
    _SCALARS,
    st.sampled_from([0, UNCERTAIN, BAD_OUT_OF_SERVICE]),
    st.sampled_from([0, 1, 2, 3]),
)
async def test_our_bytes_are_those_of_the_codec(
    row: tuple[ua.VariantType, object], code: int, asked: int
) -> None:
    kind, content = row
    variant = ua.Variant(content, kind, None, isinstance(content, list))
    source, server = datetime(2024, 1, 1, tzinfo=UTC), datetime(2024, 1, 2, tzinfo=UTC)
    value = FixedDataValue(variant, ua.StatusCode(code), source, server)
    stamps = ua.TimestampsToReturn(asked)
    plain = ua.DataValue(
        variant,
        ua.StatusCode(code),
        source if asked in (0, 2) else None,
        server if asked in (1, 2) else None,
    )
    assert value.encoded(stamps) == ua.ua_binary.to_binary(ua.DataValue, plain)


async def test_fixed_values_are_their_own_copy() -> None:
    now = datetime.now(UTC)
    fixed = FixedDataValue(
        ua.Variant(1.0, ua.VariantType.Double), ua.StatusCode(0), now, now
    )
    assert copy.deepcopy(fixed) is fixed
    plain = ua.DataValue(
        ua.Variant(1.0, ua.VariantType.Double), ua.StatusCode(0), now, now
    )
    encode = ua.ua_binary.to_binary
    assert encode(ua.DataValue, fixed) == encode(ua.DataValue, plain)


async def test_worst_status_of_an_array() -> None:
    assert worst([GOOD, UNCERTAIN, GOOD]) == UNCERTAIN
    assert worst([UNCERTAIN, BAD_OUT_OF_SERVICE, GOOD]) == BAD_OUT_OF_SERVICE
