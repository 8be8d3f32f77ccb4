"""A controller that is an OPC UA client: the robot stands still while it thinks."""

import pytest
from asyncua import Client, ua

pytestmark = pytest.mark.hil(
    config={"opcua": {"enabled": True}, "control": {"source": "opcua"}}
)


async def test_a_client_drives_half_a_metre(hil):
    async with Client(hil.endpoint) as client:
        space = await client.get_namespace_index("urn:hilserver:robot")
        names = ("pose.x_m", "control.mode", "twist.linear_m_s")
        x, mode, speed = (client.get_node(f"ns={space};s={name}") for name in names)
        await mode.write_value(1, ua.VariantType.Byte)
        for _ in range(100):
            error_m = 0.5 - await x.read_value()
            await speed.write_value(
                max(-0.3, min(2.0 * error_m, 0.3)), ua.VariantType.Double
            )
            yield 50
    assert hil.read("pose.x_m") == pytest.approx(0.5, abs=0.02)
