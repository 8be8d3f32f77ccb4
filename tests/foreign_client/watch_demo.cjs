// Watches the demonstration, then takes over: samples the pose, takes control, writes set-points.
// The pose is watched until the robot was at both ends of its figure, or for the given time.
// usage: node watch_demo.cjs <endpoint> <seconds> <end m> <set-point rpm>; prints one JSON object.
"use strict";
const {
  AttributeIds, DataType, MessageSecurityMode, OPCUAClient, SecurityPolicy, Variant,
} = require("node-opcua-client");

const [endpoint, secondsText, endText, setpointText] = process.argv.slice(2);
const NAMESPACE = "urn:hilserver:robot";
const SAMPLE_MS = 100;
const WHEELS = ["fl", "rl", "fr", "rr"];
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function main() {
  const client = OPCUAClient.create({
    endpointMustExist: false, securityMode: MessageSecurityMode.None,
    securityPolicy: SecurityPolicy.None, connectionStrategy: { maxRetry: 2 },
  });
  await client.connect(endpoint);
  const session = await client.createSession();
  const index = (await session.readNamespaceArray()).indexOf(NAMESPACE);
  const id = (path) => `ns=${index};s=${path}`;
  const values = async (paths) =>
    (await session.read(paths.map((path) => ({ nodeId: id(path), attributeId: AttributeIds.Value }))))
      .map((dataValue) => dataValue.value.value);
  const write = async (path, value) =>
    (await session.write({ nodeId: id(path), attributeId: AttributeIds.Value, value: { value } })).name;

  const poses = [];
  const until = Date.now() + Number(secondsText) * 1000;
  const end = Number(endText);
  const seen = () => poses.some(([x]) => x > end) && poses.some(([x]) => x < -end);
  while (Date.now() < until && !seen()) {
    poses.push(await values(["pose.x_m", "pose.y_m", "pose.yaw_rad"]));
    await sleep(SAMPLE_MS);
  }
  const result = { poses };
  result.control = await write("control.source", new Variant({ dataType: DataType.String, value: "opcua" }));
  const rpm = Number(setpointText);
  for (const wheel of WHEELS) {
    const value = wheel.endsWith("l") ? rpm : -rpm;  // right wheels are mirrored
    result.written = await write(`wheel.${wheel}.setpoint_rpm`, new Variant({ dataType: DataType.Double, value }));
  }
  await sleep(1500);
  result.setpoints = await values(WHEELS.map((wheel) => `wheel.${wheel}.setpoint_rpm`));
  result.speeds = await values(WHEELS.map((wheel) => `wheel.${wheel}.speed_rpm`));
  await session.close();
  await client.disconnect();
  return result;
}

main().then((result) => { console.log(JSON.stringify(result)); process.exit(0); },
  (error) => { console.error(error.message); process.exit(1); });
