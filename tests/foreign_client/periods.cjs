// Watches one variable and the events of the server in many periods at once.
// usage: node periods.cjs <endpoint> <seconds> <JSON of [period ms, queue size]>; prints one JSON
// object of arrival times [s] by "<kind> <period> <queue>".
"use strict";
const {
  AttributeIds, ClientMonitoredItem, ClientSubscription, MessageSecurityMode, OPCUAClient,
  SecurityPolicy, TimestampsToReturn, constructEventFilter,
} = require("node-opcua-client");

const [endpoint, seconds, rows] = process.argv.slice(2);
const NAMESPACE = "urn:hilserver:robot";

async function main() {
  const client = OPCUAClient.create({
    endpointMustExist: false, securityMode: MessageSecurityMode.None,
    securityPolicy: SecurityPolicy.None, connectionStrategy: { maxRetry: 2 },
  });
  await client.connect(endpoint);
  const session = await client.createSession();
  const index = (await session.readNamespaceArray()).indexOf(NAMESPACE);
  const notes = {};
  for (const [period, queue] of JSON.parse(rows)) {
    for (const kind of ["data", "events"]) {
      const times = notes[`${kind} ${period} ${queue}`] = [];
      const subscription = ClientSubscription.create(session, {
        requestedPublishingInterval: period, requestedLifetimeCount: 1000,
        requestedMaxKeepAliveCount: 20, publishingEnabled: true,
      });
      const item = kind === "data"
        ? { nodeId: `ns=${index};s=pose.x_m`, attributeId: AttributeIds.Value }
        : { nodeId: "i=2253", attributeId: AttributeIds.EventNotifier };
      const parameters = { samplingInterval: kind === "data" ? period : 0, discardOldest: true, queueSize: queue };
      if (kind === "events") {
        parameters.filter = constructEventFilter(["EventId", "Time", "Message"]);
      }
      const watched = ClientMonitoredItem.create(subscription, item, parameters, TimestampsToReturn.Both);
      watched.on("changed", () => times.push(Number(process.hrtime.bigint()) / 1e9));
    }
  }
  await new Promise((resolve) => setTimeout(resolve, Number(seconds) * 1000));
  return notes;
}

main().then((result) => { process.stdout.write(JSON.stringify(result) + "\n", () => process.exit(0)); },
  (error) => { console.error(error.stack); process.exit(1); });
