// Node-RED settings of the controller: no editor unless IOTBOT_EDITOR is 1, and then on this computer
// only; no other HTTP, nothing that calls home.
// Every path can be moved by an environment variable; the flow reads them with ${NAME}.
const path = require("path");

process.env.IOTBOT_NODESETS ||= path.join(__dirname, "nodesets");
process.env.ROS2_PORT ||= "53881"; // of ros2_bridge.py
process.env.IOTBOT_DEMO ||= "0"; // "1": drive the built-in demo when ROS 2 sends nothing

module.exports = {
  flowFile: "flows.json",
  credentialSecret: false, // the flow holds no credentials
  httpAdminRoot: process.env.IOTBOT_EDITOR === "1" ? "/" : false,
  httpNodeRoot: false,
  uiHost: "127.0.0.1",
  uiPort: Number(process.env.EDITOR_PORT || 1880),
  socketReconnectTime: 5000, // to ros2_bridge.py, which may start later, or not at all
  telemetry: { enabled: false, updateNotification: false },
  diagnostics: { enabled: false, ui: false },
  runtimeState: { enabled: false, ui: false },
  externalModules: {
    autoInstall: false,
    palette: { allowInstall: false, allowUpload: false },
    modules: { allowInstall: false },
  },
  functionExternalModules: false,
  editorTheme: { projects: { enabled: false } },
  logging: { console: { level: "info", metrics: false, audit: false } },
};
