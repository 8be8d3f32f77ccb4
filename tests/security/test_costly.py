"""What a watcher asks for costs nobody else anything: the loop gives way, whatever it is."""

import asyncio
import contextlib
import struct
import subprocess
import sys
import time
import urllib.request
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary

from benchmarks.wire import Wire
from hilserver.signals import State
from tests.helpers.daemons import running_daemon
from tests.security.costly import Requests, bytes_of, chunks

MOST_STALL_MS = 50.0
MOST_WORK_MS = 10.0
ATTACK_S = 2.0
ANSWER_S = 120.0
LIMITS = "scheduler: {limits: {single_overrun_ms: null, consecutive_overruns: null}}\n"
"""A loop that is held for longer than communication_timeout_ms ends in the safe state."""
SHORT, LONG = 80, 10_000
_References, _Attributes = ua.NodeId(ua.ObjectIds.References), ua.AttributeIds
pytestmark = pytest.mark.asyncio(loop_scope="module")


class Target:
    """The server in a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process, self.url = process, ""

    def line(self) -> str:
        assert self.process.stdout is not None
        while not (line := self.process.stdout.readline()).startswith("@ "):
            assert line, "the server has ended"
        return line.split()[1]

    def stall_ms(self) -> float:
        """Return for how long its loop was held since it was asked last."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return float(self.line())


@contextlib.contextmanager
def running(folder: Path) -> Iterator[Target]:
    command = [sys.executable, "-m", "tests.security.stall_target", str(folder)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            target = Target(process)
            target.url = target.line()
            time.sleep(0.2)
            target.stall_ms()
            yield target
        finally:
            process.kill()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def target(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Target]:
    with running(tmp_path_factory.mktemp("snapshots")) as target:
        yield target


class Asking(Wire):
    """A wire that sends long requests and takes long answers apart."""

    async def put(self, request: Any) -> Buffer | None:
        """Send a request; return its answer, None if the server closed."""
        number = self._sequence + 1
        try:
            for chunk in chunks(self, request):
                await self.send(chunk)
        except ConnectionError:
            return None
        if isinstance(request, ua.PublishRequest):
            return Buffer(b"")
        parts = []
        async with asyncio.timeout(ANSWER_S):
            while True:
                try:
                    head = await self._reader.readexactly(8)
                except (asyncio.IncompleteReadError, ConnectionError):
                    return None
                kind, chunk, size = struct.unpack("<3scI", head)
                body = await self._reader.readexactly(size - 8)
                if kind != b"MSG":
                    return None
                if struct.unpack_from("<I", body, 12)[0] == number:
                    parts.append(body[16:])
                    if chunk == b"F":
                        return Buffer(b"".join(parts))

    async def answer(self, request: Any, kind: type) -> Any:
        data = await self.put(request)
        assert data is not None
        assert (
            nodeid_from_binary(data.copy()).Identifier
            != ua.ObjectIds.ServiceFault_Encoding_DefaultBinary
        )
        return struct_from_binary(kind, data)


def work_clock(pid: int) -> int:
    """Return the clock of the processor time that a process has used: CPUCLOCK_SCHED of Linux."""
    return ~pid << 3 | 2


async def reads_ms(target: Target, until: asyncio.Event) -> list[float]:
    """Read one value again and again until the event; return what the server computed for each.

    What other processes take from the server is in no figure.
    """
    took = []
    clock = work_clock(target.process.pid)
    async with Wire(target.url) as wire:
        await wire.log_in()
        while not until.is_set():
            began_s = time.clock_gettime(clock)
            await wire.read(ua.NodeId("pose.x_m", 2))
            took.append((time.clock_gettime(clock) - began_s) * 1e3)
            await asyncio.sleep(0.005)
    return took


def browse_all(count: int) -> ua.BrowseRequest:
    request = ua.BrowseRequest()
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(
            NodeId=ua.NodeId(ua.ObjectIds.Structure),
            BrowseDirection=ua.BrowseDirection.Both,
            ReferenceTypeId=_References,
            IncludeSubtypes=True,
            ResultMask=63,
        )
    ] * count
    return request


async def test_a_thousand_browses_of_all_references_hold_nobody_up(
    target: Target,
) -> None:
    """Before: no answer in 60 s, and no event loop."""
    async with Asking(target.url) as wire:
        await wire.log_in()
        target.stall_ms()
        response = await wire.answer(browse_all(1000), ua.BrowseResponse)
    assert target.stall_ms() < MOST_STALL_MS
    codes = {result.StatusCode.name for result in response.Results}
    assert response.Results[0].StatusCode.is_good()
    assert codes <= {"Good", "BadNoContinuationPoints", "BadTimeout"}


async def test_a_thousand_long_paths_hold_nobody_up(target: Target) -> None:
    request = ua.TranslateBrowsePathsToNodeIdsRequest()
    names = ("Objects", "Server", "ServerStatus", "BuildInfo", "ProductUri")
    elements = [
        ua.RelativePathElement(_References, False, True, ua.QualifiedName(name))
        for name in names
    ]
    path = ua.BrowsePath(ua.NodeId(ua.ObjectIds.RootFolder), ua.RelativePath(elements))
    request.Parameters.BrowsePaths = [path] * 1000
    async with Asking(target.url) as wire:
        await wire.log_in()
        target.stall_ms()
        response = await wire.answer(request, ua.TranslateBrowsePathsToNodeIdsResponse)
    assert target.stall_ms() < MOST_STALL_MS
    found = [target.TargetId.Identifier for target in response.Results[0].Targets]
    assert found == [ua.ObjectIds.Server_ServerStatus_BuildInfo_ProductUri]


async def test_healthy_reads_wait_for_little_work_beside_costly_requests(
    target: Target,
) -> None:
    """Beside a client that browses everything again and again."""
    done = asyncio.Event()
    reading = asyncio.create_task(reads_ms(target, done))
    async with Asking(target.url) as wire:
        await wire.log_in()
        request = bytes_of(wire, browse_all(300))
        end_s = time.monotonic() + ATTACK_S
        while time.monotonic() < end_s:
            await wire.put(request)
    done.set()
    took = sorted(await reading)
    assert took[int(len(took) * 0.99)] < MOST_WORK_MS


async def test_a_daemon_under_attack_stays_out_of_its_safe_state_and_ends(
    tmp_path: Path,
) -> None:
    """Browse, and the event filter that each element names twice: 2^39 evaluations."""
    clauses = [ua.ContentFilterElement(ua.FilterOperator.Or) for _ in range(40)]
    for number, clause in enumerate(clauses):
        clause.FilterOperands = [ua.ElementOperand(number + 1)] * 2
    clauses[-1].FilterOperands = [ua.LiteralOperand(ua.Variant(False))] * 2
    message = ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName("Message")])
    create = ua.CreateMonitoredItemsRequest()
    item = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    item.ItemToMonitor = ua.ReadValueId(
        ua.NodeId(ua.ObjectIds.Server), ua.AttributeIds.EventNotifier
    )
    item.RequestedParameters.Filter = ua.EventFilter(
        [message], ua.ContentFilter(clauses)
    )
    create.Parameters.ItemsToCreate = [item]
    with running_daemon(tmp_path, config=LIMITS) as daemon:
        async with Asking(daemon.url) as wire:
            await wire.log_in()
            made = await wire.answer(
                ua.CreateSubscriptionRequest(), ua.CreateSubscriptionResponse
            )
            create.Parameters.SubscriptionId = made.Parameters.SubscriptionId
            answer = await wire.answer(create, ua.CreateMonitoredItemsResponse)
            assert answer.Results[0].StatusCode.name == "BadEventFilterInvalid"
            refused = ua.WriteRequest()  # publishes an event
            refused.Parameters.NodesToWrite = [
                ua.WriteValue(
                    NodeId=ua.NodeId("wheel.fl.setpoint_rpm", 2),
                    AttributeId=_Attributes.Value,
                    Value=ua.DataValue(ua.Variant(1.0)),
                )
            ]
            await wire.answer(refused, ua.WriteResponse)
            await wire.answer(browse_all(1000), ua.BrowseResponse)
            (state,) = await wire.read(ua.NodeId("sim.state", 2))
            assert State(state.Value.Value) is State.RUNNING
        url = daemon.metrics_url.replace("/metrics", "/healthz")
        with await asyncio.to_thread(urllib.request.urlopen, url, timeout=60) as health:
            assert health.status == 200
        assert daemon.stop() == 0


async def ask(target: Target, count: int, seed: int) -> list[tuple[float, str, float]]:
    """Send requests; return for each the stall [ms], the service and the time to the answer [s]."""
    requests = Requests(seed, [ua.NodeId(number) for number in range(1, 12_000)])
    plan = list(requests.services) + [None] * count
    rows: list[tuple[float, str, float]] = []
    wire = Asking(target.url)
    await wire.__aenter__()
    await wire.log_in()
    target.stall_ms()
    for number, service in enumerate(plan[:count]):
        if number and number % 500 == 0:
            print(number, max(rows), max(row[2] for row in rows), flush=True)
        name, request = requests.draw(service)
        began_s = time.monotonic()
        data = await wire.put(request)
        rows.append((target.stall_ms(), name, time.monotonic() - began_s))
        if data is None:
            await wire.__aexit__(None, None, None)
            wire = Asking(target.url)  # its channel lives for a minute
            await wire.__aenter__()
            await wire.log_in()
            requests.subscriptions = [1]
        elif name == "create_subscription":
            with contextlib.suppress(Exception):
                made = struct_from_binary(ua.CreateSubscriptionResponse, data)
                requests.subscriptions.append(made.Parameters.SubscriptionId)
        elif name == "browse":
            with contextlib.suppress(Exception):
                found = struct_from_binary(ua.BrowseResponse, data).Results
                requests.points += [
                    r.ContinuationPoint for r in found if r.ContinuationPoint
                ]
    await wire.__aexit__(None, None, None)
    return rows


def judge(rows: list[tuple[float, str, float]]) -> None:
    worst: dict[str, float] = defaultdict(float)
    for stall_ms, name, _ in rows:
        worst[name] = max(worst[name], stall_ms)
    table = sorted(((stall, name) for name, stall in worst.items()), reverse=True)
    print("\n".join(f"{stall:8.1f} ms {name}" for stall, name in table))
    print(f"longest until answered: {max(row[2] for row in rows):.2f} s")
    held = [row for row in table if row[0] >= MOST_STALL_MS]
    assert not held


async def test_no_admitted_request_holds_the_loop(target: Target) -> None:
    judge(await ask(target, SHORT, 1))


@pytest.mark.long
async def test_ten_thousand_admitted_requests(tmp_path: Path) -> None:
    with running(tmp_path) as target:
        judge(await ask(target, LONG, 2))
