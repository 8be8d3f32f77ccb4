"""Force, Unforce, InjectFault and ClearFaults over OPC UA, and where a client sees them."""

import json

from asyncua import ua

from hilserver.status import GOOD_LOCAL_OVERRIDE
from hilserver.testing.opening import open_hil
from tests.io.opcua_server.rig import RobotClient

OPCUA = {
    "opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"},
    "metrics": {"port": 0},
}


def text(value):
    return ua.Variant(value, ua.VariantType.String)


def double(value):
    return ua.Variant(value, ua.VariantType.Double)


async def test_forcing_and_faults_over_opcua():
    async with open_hil(OPCUA, "virtual") as hil:
        client = RobotClient(hil.daemon.part("opcua").url)
        await client.connect()

        async def call(name, *arguments):
            return (await client.call(name, *arguments)).StatusCode.name

        try:
            assert await call("Force", text("pose.x_m"), double(4.0)) == "Good"
            noise = {"fault": "bias", "signal": "pose.y_m", "offset": 1.5}
            assert await call("InjectFault", text(json.dumps(noise))) == "Good"
            await hil.step(200)
            forced = await client.data_value("pose.x_m")
            assert forced.Value.Value == 4.0
            assert forced.StatusCode.value == GOOD_LOCAL_OVERRIDE
            assert await client.read("pose.y_m") == 1.5
            assert await client.read("faults.injected.names") == "bias:pose.y_m"
            assert await client.read("faults.forced.names") == "pose.x_m"
            text_, _ = hil.daemon.metrics.render()
            assert b'hil_faults{kind="forced"} 1.0' in text_
            assert b'hil_faults{kind="injected"} 1.0' in text_
            assert any("force:pose.x_m" in e.message for e in hil.daemon.events.recent)
            assert await call("ClearFaults") == "Good"
            assert await call("Unforce", text("pose.x_m")) == "Good"
            await hil.step(200)
            assert await client.read("pose.y_m") == 0.0
            assert (await client.data_value("pose.x_m")).StatusCode.value == 0
            assert await client.read("faults.injected.count") == 0
            for name, arguments in (
                ("Force", [text("sim.tick"), double(1)]),
                ("Force", [text("pose.x_m"), double(float("nan"))]),
                ("Force", [text("wheel.fl.setpoint_rpm"), double(1e6)]),
                ("Unforce", [text("pose.x_m")]),
                ("InjectFault", [text("{")]),
                ("InjectFault", [text('{"fault": "bias"}')]),
                ("InjectFault", [text("[" * 60000)]),
            ):
                assert await call(name, *arguments) == "BadInvalidArgument", name
        finally:
            await client.disconnect()
