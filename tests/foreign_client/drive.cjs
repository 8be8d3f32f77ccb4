// A client of another make: browses, reads, takes control, writes, subscribes, calls a method.
// usage: node drive.cjs <endpoint> <set-point rpm>; prints one JSON object, exit code 0 when done.
"use strict";
const {
  AttributeIds, ClientMonitoredItem, ClientSubscription, DataType, MessageSecurityMode,
  OPCUAClient, SecurityPolicy, TimestampsToReturn, Variant, VariantArrayType, makeBrowsePath,
} = require("node-opcua-client");

const [endpoint, setpointText] = process.argv.slice(2);
const setpoint = Number(setpointText);
const NAMESPACE = "urn:hilserver:robot";
const TIMEOUT_MS = 20000;

const names = (codes) => codes.map((code) => code.name);

async function changesOf(session, nodeId, count, act) {
  const subscription = ClientSubscription.create(session, {
    requestedPublishingInterval: 20, requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 20, publishingEnabled: true,
  });
  const item = ClientMonitoredItem.create(
    subscription, { nodeId, attributeId: AttributeIds.Value },
    { samplingInterval: 0, discardOldest: true, queueSize: 100 }, TimestampsToReturn.Both);
  const values = [];
  await new Promise((resolve, reject) => {
    item.on("err", (text) => reject(new Error(text)));
    item.on("changed", (dataValue) => {
      values.push(dataValue.value.value);
      if (values.length === 1) act().catch(reject);
      if (values.length >= count) resolve();
    });
  });
  await subscription.terminate();
  return values;
}

async function main() {
  const client = OPCUAClient.create({
    endpointMustExist: false, securityMode: MessageSecurityMode.None,
    securityPolicy: SecurityPolicy.None, connectionStrategy: { maxRetry: 2 },
  });
  await client.connect(endpoint);
  const session = await client.createSession();
  const uris = await session.readNamespaceArray();
  const index = uris.indexOf(NAMESPACE);
  const id = (path) => `ns=${index};s=${path}`;
  const double = (value) => new Variant({ dataType: DataType.Double, value });
  const write = async (path, value) =>
    session.write({ nodeId: id(path), attributeId: AttributeIds.Value, value: { value } });

  const result = {};
  const found = await session.translateBrowsePath(makeBrowsePath(
    "RootFolder", `/Objects/${index + 1}:DeviceSet/${index}:Robot/${index}:pose/${index}:x_m`));
  result.browsed = found.targets[0].targetId.toString();
  const range = await session.read({ nodeId: id("wheel.fl.setpoint_rpm.EURange"), attributeId: AttributeIds.Value });
  result.range = [range.value.value.low, range.value.value.high];
  const pose = await session.read({ nodeId: id("pose.x_m"), attributeId: AttributeIds.Value });
  result.pose = { value: pose.value.value, status: pose.statusCode.name, stamped: pose.sourceTimestamp !== null };

  result.before_control = (await write("wheel.fl.setpoint_rpm", double(setpoint))).name;
  const di = uris.indexOf("http://opcfoundation.org/UA/DI/");
  const plate = ["Manufacturer", "Model", "SerialNumber", "SoftwareRevision"];
  const places = await session.translateBrowsePath(
    plate.map((name) => makeBrowsePath(id("robot"), `.${di}:${name}`)));
  const shown = await session.read(places.map(
    (path) => ({ nodeId: path.targets[0].targetId, attributeId: AttributeIds.Value })));
  result.nameplate = shown.map((dataValue) => dataValue.value.value.text ?? dataValue.value.value);

  const owner = new Variant({ dataType: DataType.String, value: "opcua" });
  result.take_control = (await write("control.source", owner)).name;
  const wrongType = new Variant({ dataType: DataType.Int32, value: 1 });
  result.refused = names([
    await write("wheel.fl.setpoint_rpm", double(1e6)),
    await write("wheel.fl.setpoint_rpm", double(NaN)),
    await write("wheel.fl.setpoint_rpm", wrongType),
    await write("pose.x_m", double(1)),
  ]);
  result.speeds = await changesOf(session, id("wheel.fl.speed_rpm"), 2, async () => {
    const value = new Variant({
      dataType: DataType.Double, arrayType: VariantArrayType.Array,
      value: new Float64Array([setpoint, setpoint, -setpoint, -setpoint]),
    });
    result.wrote = (await write("wheels.setpoints_rpm", value)).name;
  });
  const speeds = await session.read({ nodeId: id("wheels.speeds_rpm"), attributeId: AttributeIds.Value });
  result.all_speeds = Array.from(speeds.value.value);

  const call = (name, inputArguments) =>
    session.call({ objectId: id("methods"), methodId: id(`methods.${name}`), inputArguments });
  const pause = await call("Pause", []);
  const step = await call("Step", [{ dataType: DataType.UInt32, value: 3 }]);
  const force = await call("Force", [{ dataType: DataType.String, value: "pose.x_m" }, double(1)]);
  result.called = names([pause, step, force].map((answer) => answer.statusCode));
  await session.close();
  await client.disconnect();
  return result;
}

const timer = setTimeout(() => { console.error("timed out"); process.exit(2); }, TIMEOUT_MS);
main().then((result) => { clearTimeout(timer); console.log(JSON.stringify(result)); process.exit(0); },
  (error) => { console.error(error.message); process.exit(1); });
