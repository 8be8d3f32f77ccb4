// The controller of this example as a program of its own, in JavaScript: npm install node-opcua
const { AttributeIds, DataType, OPCUAClient, Variant } = require("node-opcua");

const TICKS = 50; // of 1 ms: the controller runs every 50 ms
const GOAL_M = 2.0, GAIN_PER_S = 2.0, MOST_M_S = 0.3;

async function main(endpoint) {
  const client = OPCUAClient.create({ endpointMustExist: false });
  await client.connect(endpoint);
  const session = await client.createSession();
  const names = await session.readNamespaceArray();
  const id = (name) => `ns=${session.getNamespaceIndex("urn:hilserver:robot")};s=${name}`;
  if (!names.includes("urn:hilserver:robot")) throw new Error("this server is no robot");
  const write = async (name, dataType, value) => {
    const code = await session.write({
      nodeId: id(name), attributeId: AttributeIds.Value, value: { value: { dataType, value } },
    });
    if (code.value !== 0) throw new Error(`${name}: ${code}`);
  };
  const step = { objectId: id("methods"), methodId: id("methods.Step"), inputArguments: [
    new Variant({ dataType: DataType.UInt32, value: TICKS })] };
  const seen = ["sim.tick", "pose.x_m"].map((name) => ({
    nodeId: id(name), attributeId: AttributeIds.Value,
  }));
  await write("control.mode", DataType.Byte, 1);
  let done = 0, x = 0.0;
  for (;;) {
    const speed = Math.max(-MOST_M_S, Math.min(GAIN_PER_S * (GOAL_M - x), MOST_M_S));
    await write("twist.linear_m_s", DataType.Double, speed);
    const answer = await session.call(step);
    if (answer.statusCode.value !== 0) throw new Error(`Step: ${answer.statusCode}`);
    done += TICKS;
    for (let tick = -1; tick < done - 1;) { // both values are of one tick
      const read = (await session.read(seen)).map((data) => data.value.value);
      tick = Number(Array.isArray(read[0]) ? read[0][1] : read[0]); // Int64: [high, low]
      x = read[1];
    }
  }
}

main(process.argv[2]).catch((error) => {
  console.error(`${error}`);
  process.exit(1);
});
