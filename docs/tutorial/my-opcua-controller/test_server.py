"""A controller that is an OPC UA server, as a PLC is: the robot reads it, in real time."""

import pytest
import pytest_asyncio
from asyncua import Server, ua

pytestmark = pytest.mark.hil(mode="realtime")
READ = {
    "nsu=urn:my:plc;s=left": ["wheel.fl.setpoint_rpm", "wheel.rl.setpoint_rpm"],
    "nsu=urn:my:plc;s=right": ["wheel.fr.setpoint_rpm", "wheel.rr.setpoint_rpm"],
}


@pytest_asyncio.fixture
async def plc():
    """Yours: one speed for each side, right wheels mirrored."""
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/plc")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace("urn:my:plc")
    for side, rpm in (("left", 30.0), ("right", -30.0)):
        await server.nodes.objects.add_variable(ua.NodeId(side, space), side, rpm)
    async with server:
        yield server


@pytest.fixture
def hil_config(plc):
    """The robot's configuration names the port that the controller has found free."""
    endpoint = f"opc.tcp://127.0.0.1:{plc.bserver.port}/plc"
    return {"peers": [{"name": "plc", "endpoint": endpoint, "read": READ}]}


async def test_the_wheels_follow_the_plc(hil):
    await hil.wait_for("wheel.fl.speed_rpm", lambda rpm: rpm > 27.0, timeout_s=60)
    await hil.wait_for("wheel.rr.speed_rpm", lambda rpm: rpm < -27.0, timeout_s=60)
