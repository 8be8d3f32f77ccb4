// A client of another make over an encrypted channel: reads, writes, is refused, browses in pages.
// usage: node secure.cjs <endpoint> <policy> <certificate.pem> <key.pem> <pki folder> <user> <password>
"use strict";
const {
  AttributeIds, DataType, MessageSecurityMode, OPCUAClient, SecurityPolicy, UserTokenType, Variant,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

const [endpoint, policy, certificateFile, privateKeyFile, rootFolder, userName, password] =
  process.argv.slice(2);

async function main() {
  const clientCertificateManager = new OPCUACertificateManager({
    rootFolder, automaticallyAcceptUnknownCertificate: true,
  });
  await clientCertificateManager.initialize();
  const client = OPCUAClient.create({
    applicationName: "foreign", endpointMustExist: true,
    securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy[policy],
    certificateFile, privateKeyFile, clientCertificateManager, connectionStrategy: { maxRetry: 1 },
  });
  await client.connect(endpoint);
  const session = await client.createSession({ type: UserTokenType.UserName, userName, password });
  const index = (await session.readNamespaceArray()).indexOf("urn:hilserver:robot");
  const id = (path) => `ns=${index};s=${path}`;
  const write = async (path, value) => (await session.write({
    nodeId: id(path), attributeId: AttributeIds.Value,
    value: { value: new Variant({ dataType: DataType.Double, value }) },
  })).name;
  const result = { policy: client.securityPolicy };
  const pose = await session.read({ nodeId: id("pose.x_m"), attributeId: AttributeIds.Value });
  result.pose = pose.value.value;
  result.wrote = await write("wheel.fl.setpoint_rpm", 5);
  result.refused = await write("pose.x_m", 5);
  const first = await session.browse({ nodeId: id("wheel.fl"), browseDirection: 0, resultMask: 63 });
  session.requestedMaxReferencesPerNode = 1;
  const paged = await session.browse({ nodeId: id("wheel.fl"), browseDirection: 0, resultMask: 63 });
  let references = paged.references, point = paged.continuationPoint;
  result.pages = 1;
  while (point && point.length) {
    const next = await session.browseNext(point, false);
    references = references.concat(next.references);
    point = next.continuationPoint;
    result.pages += 1;
  }
  result.browsed = [first.references.length, references.length];
  await session.close();
  await client.disconnect();
  console.log(JSON.stringify(result));
}

main().then(() => process.exit(0), (error) => { console.error(error); process.exit(1); });
setTimeout(() => { console.error("took too long"); process.exit(2); }, 30000);
