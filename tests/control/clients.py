# ruff: noqa: PLC0415, ASYNC110 - a client loads what it speaks, and waits for other programs
"""Whoever drives, each a process of its own: it can be closed, cut off, frozen and killed.

The processes come from a fork server that has loaded all libraries, so that a new one is there at
once. A client obeys its pipe: ``take``, ``drive`` (from now on, as often as it does that), ``rest``
(say nothing more), ``close`` (as its user would end it), ``cut`` (its connection breaks).
"""

import asyncio
import contextlib
import fcntl
import json
import multiprocessing
import os
import re
import signal
import struct
import sys
import termios
import time
from dataclasses import asdict

RENEW_S = 0.02
TELEOP_S = 0.2
SPEEDS_RPM = {
    "peer": 20.0,
    "opcua": 30.0,
    "page": 25.0,
    "ros2": 50.0,
    "shield": 60.0,
    "scenario": 40.0,
    "foxglove": 15.0,
    "teleop": 45.0,
}
"""Everybody drives straight on, at a speed of his own."""
ANSWER_WITHIN_S = 10.0
M_S_PER_RPM = 2 * 3.141592653589793 * 0.085 / 60

processes = multiprocessing.get_context("forkserver")
processes.set_forkserver_preload(
    [
        "aiohttp",
        "asyncua",
        "cyclonedds.pub",
        "cyclonedds.domain",
        "hilserver.controller.server",
        "hilserver.commands.teleop",
        "tests.control.clients",
    ]
)


class RefusedError(Exception):
    """The daemon has refused."""


class Client:
    """A client as the test sees it."""

    def __init__(self, kind, doors):
        self.kind, self.doors = kind, doors
        self._pipe, theirs = processes.Pipe()
        self.process = processes.Process(
            target=_serve, args=(kind, asdict(doors), theirs)
        )
        self.process.start()
        theirs.close()

    def do(self, what, *arguments):
        """Let it do something; return its answer."""
        self.ask(what, *arguments)
        return self.answer()

    def ask(self, what, *arguments):
        """The same without waiting for the answer."""
        self._pipe.send((what, arguments))

    def answer(self):
        assert self._pipe.poll(3 * ANSWER_WITHIN_S), f"{self.kind} does not answer"
        is_done, answer = self._pipe.recv()
        if not is_done:
            raise RefusedError(answer)
        return answer

    def freeze(self):
        os.kill(self.process.pid, signal.SIGSTOP)

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.join(10)

    def end(self):
        if self.process.is_alive():
            self.kill()
        self._pipe.close()


class Teleop(Client):
    """The program of the product, in a terminal of its own."""

    def __init__(self, kind, doors):
        self.kind, self.doors = kind, doors
        self._master, slave = os.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, b"\x18\x00\xc8\x00\x00\x00\x00\x00")
        os.set_blocking(self._master, False)
        self._slave = slave
        self.process = None

    def do(self, what, *arguments):
        self.ask(what)
        if what == "close":
            self._drain()
            self.process.join(10)

    def ask(self, what, *arguments):
        getattr(self, f"_{what}")()

    def _take(self):
        where = (
            os.ttyname(self._slave),
            self.doors.opcua,
            SPEEDS_RPM["teleop"] * M_S_PER_RPM,
        )
        self.process = processes.Process(target=_teleop, args=where)
        self.process.start()
        end_s, shown = time.monotonic() + ANSWER_WITHIN_S, ""
        while "control: " not in shown:
            shown += self._drain()
            if "has control and outranks" in shown:
                raise RefusedError(shown.strip())
            assert time.monotonic() < end_s, (
                f"teleop does not show the robot: {shown[-500:]!r}"
            )
            time.sleep(0.01)
        os.write(self._master, b"\x1b[?11u")  # this terminal reports releases

    def _drain(self):
        with contextlib.suppress(OSError):
            return os.read(self._master, 1 << 16).decode(errors="replace")
        return ""

    def _drive(self):
        os.write(self._master, b"\x1b[119;1:1u")

    def _let_go(self):
        os.write(self._master, b"\x1b[119;1:3u")
        time.sleep(TELEOP_S)  # a hand needs longer before it presses again

    def _rest(self):
        os.kill(self.process.pid, signal.SIGSTOP)

    def _close(self):
        os.write(self._master, b"x")

    def end(self):
        if self.process is not None and self.process.is_alive():
            self.kill()
        for file in (self._master, self._slave):
            os.close(file)


def client(kind, doors):
    """Start a client; it is connected once it has answered."""
    return (Teleop if kind == "teleop" else Client)(kind, doors)


def _teleop(terminal, url, speed_m_s):
    from hilserver.commands import main

    os.setsid()
    file = os.open(terminal, os.O_RDWR)
    fcntl.ioctl(file, termios.TIOCSCTTY, 0)
    for standard in (0, 1, 2):
        os.dup2(file, standard)
    # multiprocessing has closed its own
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    os._exit(main(["teleop", "--endpoint", url, "--speed", str(speed_m_s)]))


def _serve(kind, doors, pipe):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asyncio.run(KINDS[kind](kind, doors).serve(pipe))


class _Source:
    """What all have in common: commands from the pipe, and a command that is said again."""

    every_s = RENEW_S

    def __init__(self, kind, doors):
        self.kind, self.doors, self.rpm = kind, doors, SPEEDS_RPM.get(kind, 0.0)
        self.m_s = self.rpm * M_S_PER_RPM
        self._speaking, self.said_ns = None, 0

    async def serve(self, pipe):
        loop = asyncio.get_running_loop()
        news = asyncio.Event()
        loop.add_reader(pipe.fileno(), news.set)
        while True:
            await news.wait()
            news.clear()
            while pipe.poll():
                try:
                    what, arguments = pipe.recv()
                except EOFError:
                    return
                pipe.send(await self._done(what, arguments))

    async def _done(self, what, arguments):
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S - 2):
                return True, await getattr(self, what)(*arguments)
        except Exception as error:  # noqa: BLE001 - it belongs to whoever has asked
            return False, f"{type(error).__name__}: {error}"

    async def drive(self):
        await self.hold()

    async def let_go(self):
        await self.rest()

    async def hold(self):
        """Say it again and again."""
        if self._speaking is None:
            self._speaking = asyncio.create_task(self._speak())

    async def _speak(self):
        while True:
            self.said_ns = time.monotonic_ns()
            await self.say()
            await asyncio.sleep(self.every_s)

    async def rest(self):
        """Say nothing more; return when it last did."""
        if self._speaking is not None:
            self._speaking.cancel()
            await asyncio.gather(self._speaking, return_exceptions=True)
        self._speaking = None
        return self.said_ns


class _ByHand(_Source):
    """Someone who lets go before driving, as the daemon asks for after a Reset."""

    async def hold(self):
        m_s, self.m_s = self.m_s, 0.0
        if self._speaking is None:
            await self.say()
            # of two messages at once the newer one counts
            await asyncio.sleep(2 * self.every_s)
        self.m_s = m_s
        await super().hold()


class OpcUa(_Source):
    """A client as UaExpert: it writes a set-point once, and that is it."""

    async def connect(self):
        from asyncua import Client as Ua

        self._ua = Ua(
            self.doors["opcua"], ANSWER_WITHIN_S, watchdog_intervall=6 * ANSWER_WITHIN_S
        )
        self._ua.name = self.kind
        await self._ua.connect()
        self._index = await self._ua.get_namespace_index("urn:hilserver:robot")

    async def write(self, values):
        from asyncua import ua

        types = {int: ua.VariantType.Byte, float: ua.VariantType.Double}
        types |= {str: ua.VariantType.String, bool: ua.VariantType.Boolean}
        nodes = [self._node(name) for name in values]
        await self._ua.write_values(
            nodes,
            [ua.DataValue(ua.Variant(v, types[type(v)])) for v in values.values()],
        )

    def _node(self, name):
        from asyncua import ua

        return self._ua.get_node(ua.NodeId(name, self._index))

    async def take(self, source="opcua"):
        await self.write({"control.source": source})

    async def say(self):
        await self.write(
            {
                "drive.enable": True,
                "control.mode": 1,
                "twist.linear_m_s": self.m_s,
                "twist.angular_rad_s": 0.0,
            }
        )

    async def drive(self):
        await self.say()

    async def _speak(self):
        from asyncua import ua

        while True:
            self.said_ns = time.monotonic_ns()
            with contextlib.suppress(ua.UaStatusCodeError):  # refused, and it goes on
                await self.say()
            await asyncio.sleep(self.every_s)

    async def call(self, method, *arguments):
        from asyncua import ua

        given = [
            ua.Variant(a, ua.VariantType.UInt32) if type(a) is int else a
            for a in arguments
        ]
        await self._node("methods").call_method(self._node(f"methods.{method}"), *given)

    async def press(self):
        """Stop; return when it was pressed."""
        pressed_ns = time.monotonic_ns()
        await self.call("Stop")
        return pressed_ns

    async def close(self):
        await self._ua.disconnect()

    async def cut(self):
        self._ua.uaclient.protocol.transport.abort()


class Page(_ByHand):
    """A browser with the operator page in it."""

    every_s = 0.05

    async def connect(self):
        import aiohttp

        url = self.doors["page"]
        self._url, self._stamp, self._number = url, 0, 0
        self._origin = {"Origin": url.rstrip("/")}
        self._session = aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True))
        await self._load()
        self._socket = await self._session.ws_connect(
            f"{url}api/live", headers=self._origin
        )
        await self._socket.send_json({"ticket": await self.call("ticket")})
        self._number = (await self._socket.receive_json())["you"]
        await self._socket.send_json({"subscribe": ["sim.tick"], "number": 1})
        self._reading = asyncio.create_task(self._read())
        while not self._stamp:
            await asyncio.sleep(0.005)

    async def _load(self):
        import aiohttp

        for _ in range(
            100
        ):  # the page's own process needs a moment longer than the daemon
            with contextlib.suppress(aiohttp.ClientError):
                async with self._session.get(self._url) as response:
                    text = await response.text()
                    self._token = re.search(r'name="token" content="([^"]+)"', text)[1]
                    return
            await asyncio.sleep(0.1)

    async def _read(self):
        async for message in self._socket:
            if isinstance(message.data, bytes):
                (self._stamp,) = struct.unpack_from("<I", message.data, 4)

    async def call(self, method, *arguments):
        headers = {"X-Hilserver-Token": self._token} | self._origin
        body = {"method": method, "arguments": arguments}
        async with self._session.post(
            f"{self._url}api/call", json=body, headers=headers
        ) as answer:
            told = await answer.json()
        if not told["ok"]:
            raise RefusedError(told["text"])
        return told["result"]

    async def take(self):
        await self.call("take", self._number)

    async def say(self):
        command = {
            "mode": "twist",
            "linear": self.m_s,
            "turn": 0.0,
            "seen": self._stamp,
        }
        await self._socket.send_json({"drive": command})

    async def press(self):
        """Stop, over the open socket; return when it was pressed."""
        pressed_ns = time.monotonic_ns()
        await self._socket.send_json({"stop": 1})
        return pressed_ns

    async def close(self):
        await self._socket.close()
        await self._session.close()

    async def cut(self):
        self._socket._response.connection.transport.abort()


class Foxglove(_ByHand):
    """A viewer with a teleoperation panel."""

    every_s = 0.05

    async def connect(self):
        import aiohttp

        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(
            self.doors["foxglove"], protocols=["foxglove.sdk.v1"]
        )
        channel = {
            "id": 1,
            "topic": "/cmd_vel",
            "encoding": "json",
            "schemaName": "Twist",
        }
        await self._socket.send_json({"op": "advertise", "channels": [channel]})
        self._reading = asyncio.create_task(self._read())

    async def _read(self):
        async for _ in self._socket:
            pass

    async def say(self):
        twist = {"linear": {"x": self.m_s}, "angular": {"z": 0.0}}
        await self._socket.send_bytes(
            struct.pack("<BI", 1, 1) + json.dumps(twist).encode()
        )

    async def close(self):
        await self._socket.close()
        await self._session.close()

    async def cut(self):
        self._socket._response.connection.transport.abort()


class Peer(_Source):
    """A controller: the server that our client reads."""

    async def connect(self):
        from hilserver.controller.server import ControllerServer

        self._server = ControllerServer(self.doors["peer"])
        await self._server.__aenter__()
        self._sequence = 0

    async def say(self):
        from datetime import UTC, datetime

        self._sequence += 1
        signs = {"FL": 1, "RL": 1, "FR": -1, "RR": -1}
        speeds = {f"rpm_set_{wheel}": sign * self.rpm for wheel, sign in signs.items()}
        values = speeds | {"enable": True, "seq": self._sequence}
        await self._server.offer(values, datetime.now(UTC))

    async def close(self):
        await self.rest()
        await self._server.__aexit__()

    async def cut(self):
        for protocol in tuple(self._server._server.bserver.clients):
            protocol.transport.abort()


class Ros2(_Source):
    """A node of ROS 2 that publishes wheel speeds."""

    async def connect(self):
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.topic import Topic

        from tests.control.dds import LOOPBACK, RotationSpeed

        number = self.doors["domain"]
        self._domain = Domain(number, LOOPBACK)
        self._participant = DomainParticipant(number)
        reliable = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(10))
        topic = Topic(self._participant, "rt/iotbot/rpm", RotationSpeed)
        self._writer = DataWriter(self._participant, topic, reliable)
        self._message = RotationSpeed(self.rpm, -self.rpm, self.rpm, -self.rpm)
        while not self._writer.get_publication_matched_status().current_count:
            await asyncio.sleep(0.01)

    async def say(self):
        self._writer.write(self._message)

    async def close(self):
        await self.rest()
        self._writer = self._participant = self._domain = None


class Shield(_Source):
    """The host of the robot's own driver on the serial line."""

    async def connect(self):
        file = os.open(self.doors["shield"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        asyncio.get_running_loop().add_reader(file, self._drop, file)
        self._file = file

    @staticmethod
    def _drop(file):
        with contextlib.suppress(OSError):
            os.read(file, 4096)

    def _send(self, command, payload=b""):
        os.write(self._file, bytes((0xFF, command)) + payload.ljust(8, b"\0") + b"\xee")

    async def enable(self):
        self._send(0x01)

    async def drive(self):
        await self.enable()
        await asyncio.sleep(RENEW_S)
        await super().drive()

    async def say(self):
        rpm = round(self.rpm * 100)
        self._send(0x11, struct.pack("<4h", -rpm, -rpm, rpm, rpm))  # rr, fr, rl, fl

    async def close(self):
        await self.rest()
        self._send(0x02)
        await self.cut()

    async def cut(self):
        await self.rest()
        asyncio.get_running_loop().remove_reader(self._file)
        os.close(self._file)


KINDS = {
    "opcua": OpcUa,
    "engineer": OpcUa,
    "page": Page,
    "operator": Page,
    "foxglove": Foxglove,
    "peer": Peer,
    "ros2": Ros2,
    "shield": Shield,
}
