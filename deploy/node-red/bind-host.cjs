// The OPC UA server node has no setting for the address and listens on every interface.
// Preloaded with `node -r ./bind-host.cjs`, this forces the address in BIND_HOST (loopback if unset).
const net = require("net");
const listen = net.Server.prototype.listen;

net.Server.prototype.listen = function (...args) {
  const host = process.env.BIND_HOST || "127.0.0.1";
  const callback = args.find((arg) => typeof arg === "function");
  if (typeof args[0] === "object" && args[0] !== null && "port" in args[0]) {
    return listen.call(this, { ...args[0], host }, callback);
  }
  if (Number.isInteger(Number(args[0]))) {
    return listen.call(this, { port: Number(args[0]), host }, callback);
  }
  return listen.apply(this, args); // pipes and handles
};
