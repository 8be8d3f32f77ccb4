// Drives the robot through data block 1 until it turns, as a panel would; prints what it read last.
// node drive.cjs PORT
const Nodes7 = require("nodes7");
const connection = new Nodes7({ silent: true });
const LEFT = ["DB1,REAL0", "DB1,REAL4"];
const SPEED = "DB1,LREAL16";

function fail(why) {
  console.error(why);
  process.exit(1);
}

function step() {
  connection.writeItems([...LEFT, "DB1,X24.1"], [30, 30, true], (refused) => {
    if (refused) fail("a write was refused");
    connection.readAllItems((bad, values) => {
      if (bad) fail(`a value is bad: ${JSON.stringify(values)}`);
      if (values[SPEED] < 20) return setTimeout(step, 50);
      connection.writeItems(SPEED, 1, (denied) => {
        console.log(JSON.stringify({ values, denied }));
        connection.dropConnection(() => process.exit(0));
      });
    });
  });
}

connection.initiateConnection(
  { host: "127.0.0.1", port: Number(process.argv[2]), rack: 0, slot: 1, timeout: 60000 },
  (error) => {
    if (error) fail(error);
    connection.setTranslationCB((tag) => tag);
    connection.addItems([...LEFT, "DB1,DINT8", SPEED, "DB1,X24.1"]);
    step();
  },
);
