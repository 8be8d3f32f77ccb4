"""A real Node-RED in its own home, started headless on loopback."""

import asyncio
import json
import os
import shutil
import signal
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
DEPLOY = HERE.parent.parent / "deploy" / "node-red"
INSTALL = "npm install --no-package-lock --no-audit --no-fund --prefix tests/node_red"
START_LIMIT_S = 240.0

SINK_TAB = "tab-test-sink"


def missing() -> str:
    """Return in one sentence what is not installed; empty when all is there."""
    if shutil.which("node") is None:
        return "Node.js 20 is not installed, the Node-RED tests need it"
    for package in ("node-red", "node-red-contrib-opcua"):
        if not (HERE / "node_modules" / package).is_dir():
            return f"{package} is not installed: run '{INSTALL}'"
    return ""


def with_sink(flow: list[dict], sink: Path, out: str = "sensors-out") -> list[dict]:
    """Return a flow with its link out `out` led into a file, one JSON per line."""
    flow = json.loads(json.dumps(flow))
    for node in flow:
        if node["id"] == out:
            node["links"] = [*node["links"], "sink-in"]
    text = "return { payload: JSON.stringify([msg.topic, msg.payload, Date.now()]) };"
    return [
        *flow,
        {"id": SINK_TAB, "type": "tab", "label": "what the test sees"},
        {
            "id": "sink-in",
            "type": "link in",
            "z": SINK_TAB,
            "links": [out],
            "wires": [["sink-text"]],
        },
        {
            "id": "sink-text",
            "type": "function",
            "z": SINK_TAB,
            "func": text,
            "outputs": 1,
            "libs": [],
            "wires": [["sink-file"]],
        },
        {
            "id": "sink-file",
            "type": "file",
            "z": SINK_TAB,
            "filename": str(sink),
            "filenameType": "str",
            "appendNewline": True,
            "createDir": False,
            "overwriteFile": "false",
            "encoding": "utf8",
            "wires": [[]],
        },
    ]


@dataclass
class NodeRed:
    """One installation with one flow; it can be started, stopped and killed again and again."""

    home: Path
    port: int
    flow: list[dict]
    host: str = "127.0.0.1"
    prefix: tuple[str, ...] = ()
    process: asyncio.subprocess.Process | None = None
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def endpoint(self) -> str:
        return f"opc.tcp://{self.host}:{self.port}/UA/NodeRedAgv"

    @property
    def log(self) -> str:
        path = self.home / "node-red.log"
        return path.read_text(encoding="utf-8") if path.exists() else ""

    async def start(self, *, ready: bool = True) -> "NodeRed":
        self.home.mkdir(parents=True, exist_ok=True)
        modules = self.home / "node_modules"
        if not modules.exists():
            modules.symlink_to(HERE / "node_modules")
        (self.home / "flows.json").write_text(json.dumps(self.flow), encoding="utf-8")
        environment = {
            "PATH": os.environ["PATH"],
            "HOME": str(self.home),
            "XDG_CONFIG_HOME": str(self.home),
            "SERVER_PORT": str(self.port),
            "BIND_HOST": self.host,
            "IOTBOT_DEMO": "1",
        } | self.environment
        with (self.home / "node-red.log").open("ab") as log:
            self.process = await asyncio.create_subprocess_exec(
                *self.prefix,
                "node",
                "-r",
                str(DEPLOY / "bind-host.cjs"),
                str(HERE / "node_modules" / "node-red" / "red.js"),
                "--userDir",
                str(self.home),
                "--settings",
                str(DEPLOY / "settings.js"),
                "flows.json",
                cwd=self.home,
                env=environment,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        if ready:
            await self.wait_ready()
        return self

    async def wait_ready(self) -> None:
        async with asyncio.timeout(START_LIMIT_S):
            while True:
                assert self.process is not None
                assert self.process.returncode is None, self.log
                try:
                    _, writer = await asyncio.open_connection(self.host, self.port)
                except OSError:
                    await asyncio.sleep(0.02)
                    continue
                writer.close()
                return

    async def kill(self) -> None:
        """kill -9."""
        await self._end(signal.SIGKILL)

    async def stop(self) -> None:
        await self._end(signal.SIGTERM)

    async def _end(self, number: int) -> None:
        if self.process is None:
            return
        if self.process.returncode is None:
            self.process.send_signal(number)
            try:
                async with asyncio.timeout(120):
                    await self.process.wait()
            except TimeoutError:
                self.process.kill()
                await self.process.wait()
        self.process = None


def shipped_flow() -> list[dict]:
    return json.loads((DEPLOY / "flows.json").read_text(encoding="utf-8"))


def test_flow(name: str) -> list[dict]:
    return json.loads((HERE / "flows" / f"{name}.json").read_text(encoding="utf-8"))


test_flow.__test__ = False
