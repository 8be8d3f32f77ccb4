"""Parameters over OPC UA: read by all, written by engineers, all of one Write in one tick."""

import math
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.parameters import PLANT
from hilserver.testing.hil import Hil
from hilserver.testing.opening import open_hil
from tests.io.opcua_server.rig import RobotClient

OPCUA = {"opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"}}
DOUBLE = ua.VariantType.Double
pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def kit(tmp_path_factory) -> AsyncIterator[Hil]:
    folder = {"folders": {"patches": str(tmp_path_factory.mktemp("patches"))}}
    async with open_hil(OPCUA | folder, "virtual") as opened:
        yield opened


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(kit: Hil) -> AsyncIterator[RobotClient]:
    found = RobotClient(kit.daemon.part("opcua").url)
    await found.connect()
    yield found
    await found.disconnect()


@pytest_asyncio.fixture(autouse=True, loop_scope="module")
async def as_configured(kit: Hil) -> AsyncIterator[None]:
    yield
    kit.daemon.core.parameters.reset()
    await kit.step(1)


async def write(client, **values):
    return await client.write(
        *((f"parameters.{n}", v, DOUBLE) for n, v in values.items())
    )


async def test_every_parameter_is_there_with_range_unit_and_meaning(kit, client):
    for name, parameter in PLANT.items():
        node = client.path(f"parameters.{name}")
        value = await node.read_value()
        shown = kit.daemon.core.parameters.values[name]
        assert value == shown or (math.isnan(value) and math.isnan(shown)), name
        properties = {
            (await p.read_browse_name()).Name: p for p in await node.get_properties()
        }
        eu_range = await properties["EURange"].read_value()
        unit = await properties["EngineeringUnits"].read_value()
        assert (eu_range.Low, eu_range.High) == (parameter.low, parameter.high)
        assert unit.DisplayName.Text == parameter.unit
        assert parameter.meaning in (await node.read_description()).Text


async def test_two_changes_of_one_write_act_in_one_tick(kit, client):
    slot = kit.daemon.table.slot("internal.edition")
    before, tick = kit.daemon.image.latest().values[slot], kit.tick
    values = {"plant.controller.k_p": 15.0, "terms.rotation_gain": -0.3}
    assert await write(client, **values) == ["Good", "Good"]
    assert await client.read("parameters.terms.rotation_gain") == -0.3
    await kit.step(1)
    frame = kit.daemon.image.latest()
    assert (frame.tick, frame.values[slot]) == (tick, before + 1)
    assert kit.daemon.core.parameters.differing == values


async def test_null_is_nan(kit, client):
    assert await write(client, **{"terms.setpoint_rate_limit": 100.0}) == ["Good"]
    assert await write(client, **{"terms.setpoint_rate_limit": math.nan}) == ["Good"]
    assert math.isnan(await client.read("parameters.terms.setpoint_rate_limit"))
    assert kit.daemon.core.parameters.differing == {}


async def test_k_om_has_names_and_null_is_what_is_configured(kit, client):
    def text(value):
        return ua.Variant(value, ua.VariantType.String)

    async def named(name, value):
        return (
            await client.call("SetParameter", text(name), text(value))
        ).StatusCode.name

    gain = "kinematics.rotation_gain"
    parameters = kit.daemon.core.parameters
    for value, number in {"tile": 1.052, "1.5": 1.5, "carpet_soft": 1.03}.items():
        assert await named(gain, value) == "Good"
        assert parameters.values[gain] == number
    for null in ("null", "geometric_skid"):
        assert await named(gain, "tile") == "Good"
        assert await named(gain, null) == "Good"
        assert parameters.differing == {}
    for wrong in ("geometric_diff", "parquet", "", "nan?", "inf"):
        assert await named(gain, wrong) == "BadInvalidState"
    assert await named("plant.controller.k_p", "tile") == "BadInvalidState"
    assert parameters.differing == {}


async def test_exclusive_mode_acts_at_a_tick(kit, client):
    """Forward and turning at once: of the wheels' speeds only the larger part is left."""
    kit.write({"control.mode": 1, "twist.linear_m_s": 0.3, "twist.angular_rad_s": 0.5})
    await kit.step(2)

    def demands():
        return [kit.read(f"wheel.{wheel}.demand_rpm") for wheel in ("fl", "fr")]

    left, right = demands()
    assert left != -right
    assert await write(client, **{"plant.exclusive_twist": 1.0}) == ["Good"]
    await kit.step(1)
    left, right = demands()
    assert left == -right > 0
    assert await write(client, **{"plant.exclusive_twist": 0.0}) == ["Good"]
    await kit.step(1)
    assert demands()[0] != left


@pytest.mark.parametrize(
    ("values", "code", "text"),
    [
        ({"plant.controller.k_p": math.nan}, "BadOutOfRange", "cannot be null"),
        ({"plant.controller.k_p": 1e308}, "BadOutOfRange", "is outside"),
        ({"plant.controller.k_p": 1e6}, "BadOutOfRange", "unstable"),
        ({"plant.wheel_radius_m": -0.1}, "BadOutOfRange", "is outside"),
        ({"plant.icr_offset_m": 0.2}, "BadOutOfRange", "half the wheelbase"),
        ({"mechatronic.tyre.mu_lat": 0.5}, "BadNotWritable", "needs a restart"),
        ({"plant.controller.kp": 1.0}, "BadNodeIdUnknown", None),
    ],
)
async def test_what_cannot_be_is_a_status_and_a_sentence(
    kit, client, values, code, text
):
    before = dict(kit.daemon.core.parameters.values)
    assert await write(client, **values) == [code]
    assert kit.daemon.core.parameters.values == pytest.approx(before, nan_ok=True)
    if text is not None:
        assert text in kit.daemon.events.recent[-1].message


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (1, ua.VariantType.Int64),
        ([1.0], DOUBLE),
        ("1", ua.VariantType.String),
        (True, None),
    ],
)
async def test_only_a_double_is_a_double(kit, client, value, kind):
    codes = await client.write(("parameters.plant.max_rpm", value, kind))
    assert codes == ["BadTypeMismatch"]
    assert kit.daemon.core.parameters.differing == {}


async def test_a_sound_change_beside_one_that_is_none(kit, client):
    codes = await write(client, **{"plant.max_rpm": 70.0, "plant.track_m": math.inf})
    assert codes == ["Good", "BadOutOfRange"]
    assert kit.daemon.core.parameters.differing == {"plant.max_rpm": 70.0}


async def test_what_was_tuned_is_saved_reset_and_loaded(kit, client):
    def text(value):
        return ua.Variant(value, ua.VariantType.String)

    tuned = {"plant.controller.k_i": 150.0, "terms.dead_zone": 2.0}
    assert (
        await client.call("SaveParameters", text("own"))
    ).StatusCode.name == "BadInvalidState"
    assert await write(client, **tuned) == ["Good", "Good"]
    assert (await client.call("SaveParameters", text("../own"))).StatusCode.name == (
        "BadInvalidArgument"
    )
    assert (await client.call("SaveParameters", text("own"))).StatusCode.name == "Good"
    assert (
        await client.call("SaveParameters", text("own"))
    ).StatusCode.name == "BadInvalidState"
    assert (await client.call("ResetParameters")).StatusCode.name == "Good"
    assert await client.read("parameters.terms.dead_zone") == 0.0
    assert kit.daemon.core.parameters.differing == {}
    assert (await client.call("LoadPatch", text("own.yaml"))).StatusCode.name == "Good"
    assert kit.daemon.core.parameters.differing == tuned
    assert (await client.call("RemovePatch")).StatusCode.name == "Good"
    assert kit.daemon.core.parameters.differing == {}


@pytest.mark.parametrize(
    ("role", "code"), [("operator", "BadUserAccessDenied"), ("engineer", "Good")]
)
async def test_only_an_engineer_changes_the_robot(role, code):
    opcua = {
        **OPCUA["opcua"],
        "anonymous": role,
        "permissions": {"write": {"*": "observer"}},
    }
    async with open_hil({"opcua": opcua}, "virtual") as kit:
        found = RobotClient(kit.daemon.part("opcua").url)
        await found.connect()
        assert await write(found, **{"plant.max_rpm": 70.0}) == [code]
        assert await found.read("parameters.plant.max_rpm") == (
            90.0 if code != "Good" else 70.0
        )
        await found.disconnect()
