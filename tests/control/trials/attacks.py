"""What strangers and bad luck do to a daemon while somebody drives; most are processes.

An attack goes on between `on` and `off`; `strike` comes right before the moment that counts.
"""

import asyncio
import contextlib
import json
import os
import signal
import time

from asyncua import Client, ua

from tests.control.clients import processes

STRUCTURE, REFERENCES = ua.NodeId(22), ua.NodeId(ua.ObjectIds.References)
UNKNOWN_NAMES = 1900
DEPTH = 40
RETRY_S = 0.05
STRUCK_S = 0.03
ANSWER_WITHIN_S = 60


class Attack:
    """None: the robot is left alone."""

    def __init__(self, robot):
        self.robot = robot

    def on(self):
        pass

    def off(self):
        pass

    def strike(self, seconds):
        pass

    def end(self):
        pass


class Lock(Attack):
    """A call in the daemon keeps the interpreter lock."""

    def strike(self, seconds):
        self.robot.hold(seconds)
        time.sleep(STRUCK_S)


class Stalled(Attack):
    """Ctrl-S in the terminal of the daemon."""

    def on(self):
        self.robot.stall()

    def off(self):
        self.robot.go_on()


class Others(Attack):
    """Processes; without `on` they stand still."""

    def __init__(self, robot, count, target, *args):
        super().__init__(robot)
        self._processes = [
            processes.Process(target=target, args=args) for _ in range(count)
        ]
        for process in self._processes:
            process.start()
        self.off()

    def on(self):
        self._send(signal.SIGCONT)

    def off(self):
        self._send(signal.SIGSTOP)

    def end(self):
        for process in self._processes:
            process.kill()
            process.join(10)

    def _send(self, what):
        for process in self._processes:
            os.kill(process.pid, what)


def _spin():
    """Take all processor time there is, at the niceness of whoever started this."""
    while True:  # until it is killed
        pass


# --- the floods -----------------------------------------------------------------------------------


def _flood(name, opcua, foxglove):
    asyncio.run(_repeated(FLOODS[name], foxglove if name == "foxglove" else opcua))


async def _repeated(flood, url):
    while True:  # until it is killed
        with contextlib.suppress(ua.UaError, OSError, TimeoutError):
            await flood(url)
        await asyncio.sleep(RETRY_S)


def _browse(node, count):
    async def browse(url):
        asked = ua.BrowseDescription(
            NodeId=node,
            BrowseDirection=ua.BrowseDirection.Both,
            ReferenceTypeId=REFERENCES,
            IncludeSubtypes=True,
            ResultMask=63,
        )
        request = ua.BrowseParameters(NodesToBrowse=[asked] * count)
        async with Client(url, timeout=ANSWER_WITHIN_S) as client:
            while True:
                with contextlib.suppress(ua.UaStatusCodeError):
                    await client.uaclient.browse(request)

    return browse


async def _translate(url):
    step = ua.RelativePathElement(REFERENCES, False, True, ua.QualifiedName("absent"))
    path = ua.BrowsePath(STRUCTURE, ua.RelativePath([step] * 6))
    async with Client(url, timeout=ANSWER_WITHIN_S) as client:
        while True:
            with contextlib.suppress(ua.UaStatusCodeError):
                await client.uaclient.translate_browsepaths_to_nodeids([path] * 1000)


async def _event_filter(url):
    elements = [
        ua.ContentFilterElement(
            ua.FilterOperator.Or, [ua.ElementOperand(index + 1)] * 2
        )
        for index in range(DEPTH - 1)
    ]
    never = ua.LiteralOperand(ua.Variant(False))
    elements.append(ua.ContentFilterElement(ua.FilterOperator.Or, [never, never]))
    message = ua.SimpleAttributeOperand(
        ua.NodeId(ua.ObjectIds.BaseEventType),
        [ua.QualifiedName("Message")],
        ua.AttributeIds.Value,
    )
    item = ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(
            ua.NodeId(ua.ObjectIds.Server), ua.AttributeIds.EventNotifier
        ),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(
            Filter=ua.EventFilter([message], ua.ContentFilter(elements)), QueueSize=10
        ),
    )
    async with Client(url, timeout=ANSWER_WITHIN_S) as client:
        subscription = await client.create_subscription(50, None)
        request = ua.CreateMonitoredItemsParameters(
            subscription.subscription_id, ua.TimestampsToReturn.Both, [item]
        )
        while True:
            await client.uaclient.create_monitored_items(request)
            await asyncio.sleep(RETRY_S)


async def _unknown_names(url):
    import aiohttp  # noqa: PLC0415 - the attacks are named where there is none

    names = json.dumps(
        {f"no.such.signal.{i}.x": i for i in range(UNKNOWN_NAMES)}
    ).encode()
    channel = {
        "id": 1,
        "topic": "/hilserver/set",
        "encoding": "json",
        "schemaName": "Set",
    }
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(url, protocols=["foxglove.sdk.v1"]) as socket,
    ):
        await socket.send_json({"op": "advertise", "channels": [channel]})
        while not socket.closed:
            await socket.send_bytes(b"\x01\x01\x00\x00\x00" + names)
            await asyncio.sleep(0)


FLOODS = {
    "browse15": _browse(STRUCTURE, 15),
    "browse20": _browse(REFERENCES, 20),
    "browse1000": _browse(REFERENCES, 1000),
    "translate": _translate,
    "event_filter": _event_filter,
    "foxglove": _unknown_names,
}


def attack(name, robot):
    """Return an attack on a robot that runs; it is off."""
    if name in FLOODS:
        doors = robot.doors
        # it asks again as soon as it is answered
        return Others(robot, 1, _flood, name, doors.opcua, doors.foxglove)
    if name == "busy":
        return Others(robot, 2 * len(os.sched_getaffinity(0)), _spin)
    return {"idle": Attack, "ctrl_s": Stalled, "lock": Lock}[name](robot)
