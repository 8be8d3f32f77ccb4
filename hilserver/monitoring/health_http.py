"""The endpoint of metrics and health: ``/metrics``, ``/healthz``, ``/readyz`` on the event loop.

The client library's own server uses a thread per request and listens on every address. This one
shares the daemon's loop and limits everything that a client can cost: the size of a request, the
time to send it and to take the answer, the number of connections (when all places are taken, the
one that has waited longest makes room), and the work of rendering (an answer serves all scrapes of
the next `RENDER_EVERY_S`).
"""

import asyncio
import json
import socket
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus

import structlog

from hilserver.errors import address_refused
from hilserver.monitoring.health_request import (
    HealthRequest,
    RefusedRequestError,
    parse_request,
)
from hilserver.program.event_loop import stop_listening
from hilserver.signals import State
from hilserver.tasks import SupervisedTask, Supervisor
from hilserver.time_limit import time_limit


@dataclass(frozen=True, slots=True)
class HealthVerdict:
    """The answer to one question."""

    ok: bool
    reason: str


@dataclass(frozen=True, kw_only=True)
class HealthSources:
    """Inputs of the health checks."""

    state: Callable[[], str]  # state of the daemon in lower case, ``running`` and so on
    # CLOCK_MONOTONIC [ns] of the newest wake-up of the pacing back end; 0 before the first
    heartbeat_ns: Callable[[], int]
    # True once the first ticks after the warm-up met their deadlines
    first_ticks_met: Callable[[], bool]
    # which task does not run although it should
    tasks_down: Callable[[], str] = lambda: ""
    heartbeat_limit_s: float = 1.0  # a pacing back end silent for longer [s] is dead


def alive(sources: HealthSources, now_ns: int) -> HealthVerdict:
    """Judge the heartbeat of the pacing back end at `now_ns` [CLOCK_MONOTONIC ns].

    It also beats while paused; a frozen one is dead even if the event loop still answers.
    """
    heartbeat_ns = sources.heartbeat_ns()
    if heartbeat_ns == 0:
        if sources.state() == State.STARTING.word:
            return HealthVerdict(True, "the plant is being compiled and warmed up")
        return HealthVerdict(False, "the pacing back end has never woken up")
    age_s = (now_ns - heartbeat_ns) / 1e9
    if age_s > sources.heartbeat_limit_s:
        return HealthVerdict(
            False, f"the pacing back end last woke up {age_s:.1f} s ago"
        )
    return HealthVerdict(True, "the pacing back end is running")


def ready(sources: HealthSources, now_ns: int) -> HealthVerdict:
    """Judge whether the robot is being simulated in time at `now_ns` [CLOCK_MONOTONIC ns]."""
    verdict = alive(sources, now_ns)
    if not verdict.ok:
        return verdict
    state = sources.state()
    if state != State.RUNNING.word:
        return HealthVerdict(False, f"the state is {state}, not running")
    if not sources.first_ticks_met():
        return HealthVerdict(False, "the first ticks have not met their deadlines yet")
    if why := sources.tasks_down():
        return HealthVerdict(False, why)
    return HealthVerdict(True, "running, and the first ticks met their deadlines")


REQUEST_BYTES_MAX = 8192
CONNECTIONS_MAX = 128
TIMEOUT_S = 2.0
LINGER_S = 0.2
RENDER_EVERY_S = 0.05

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Response:
    """An answer; `headers` in addition to those of every answer."""

    status: HTTPStatus
    body: bytes
    content_type: str = "text/plain; charset=utf-8"
    headers: tuple[tuple[str, str], ...] = ()

    def encode(self, *, is_head: bool = False) -> bytes:
        """Return the bytes to send; a HEAD request gets only the head."""
        length = ("Content-Length", str(len(self.body)))
        fields = (
            ("Content-Type", self.content_type),
            length,
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            ("Connection", "close"),
            *self.headers,
        )
        lines = [f"HTTP/1.1 {self.status.value} {self.status.phrase}"]
        lines += [f"{name}: {value}" for name, value in fields]
        head = "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n"
        return head if is_head else head + self.body


class HttpServer:
    """Serves metrics and health on one address.

    Port 0 takes a free one. Requests may name addresses, localhost and `host_names` as the host.
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 9464,
        render: Callable[[bool], tuple[bytes, str]],
        health: HealthSources,
        host_names: Collection[str] = (),
        timeout_s: float = TIMEOUT_S,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        tasks: Supervisor | None = None,
    ) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self.host = host
        self.port = port
        self._render = render
        self._health = health
        self._timeout_s = timeout_s
        self._clock_ns = clock_ns
        self._server: asyncio.Server | None = None
        self._names = {
            name.lower() for name in ("localhost", socket.gethostname(), *host_names)
        }
        self._open: dict[
            SupervisedTask, asyncio.WriteTransport
        ] = {}  # connections, the oldest first
        self._rendered: dict[bool, tuple[int, Response]] = {}
        self._routes: dict[str, Callable[[HealthRequest], Response]] = {
            "/metrics": self._metrics,
            "/healthz": lambda _: self._probe(alive(self._health, self._clock_ns())),
            "/readyz": lambda _: self._probe(ready(self._health, self._clock_ns())),
        }

    @property
    def url(self) -> str:
        """Address of the metrics, for people."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/metrics"

    address = url

    async def start(self) -> None:
        """Listen; raise `FailedError` if the address cannot be used."""
        try:
            self._server = await asyncio.start_server(
                self._accept, self.host, self.port, limit=REQUEST_BYTES_MAX
            )
        except OSError as error:
            where = f"{self.host} port {self.port}"
            raise address_refused(f"metrics: cannot listen on {where}", error) from None
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        """Stop listening and end all connections."""
        if self._server is None:
            return
        await stop_listening(self._server)
        for job in tuple(self._open):
            await job.end()
        await self._server.wait_closed()
        self._server = None

    def _accept(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        if len(self._open) >= CONNECTIONS_MAX:
            oldest = next(iter(self._open))
            self._open.pop(oldest).abort()
            oldest.cancel()
        job = self._tasks.spawn(partial(self._serve, reader, writer), "metrics request")
        self._open[job] = writer.transport

        def ended() -> None:
            self._open.pop(job, None)
            writer.transport.abort()  # also if it was cancelled before its first step

        job.on_end = ended

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        # so that drain waits for the last byte
        writer.transport.set_write_buffer_limits(high=0)
        try:
            answer = await self._answer(reader)
            async with time_limit(self._timeout_s):
                writer.write(answer)
                await writer.drain()
                await _linger(reader, writer)
        except (OSError, TimeoutError, asyncio.IncompleteReadError):
            pass  # it has left or does not read: an answer is pointless

    async def _answer(self, reader: asyncio.StreamReader) -> bytes:
        try:
            async with time_limit(self._timeout_s):
                head = await reader.readuntil(b"\r\n\r\n")
            request = parse_request(head, self._names)
            return self._respond(request).encode(is_head=request.is_head)
        except TimeoutError:
            reason = f"no complete request arrived within {self._timeout_s:g} s"
            return Response(HTTPStatus.REQUEST_TIMEOUT, _sentence(reason)).encode()
        except asyncio.LimitOverrunError:
            reason = f"the head of a request may have at most {REQUEST_BYTES_MAX} bytes"
            status = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
            return Response(status, _sentence(reason)).encode()
        except RefusedRequestError as refused:
            is_method = refused.status is HTTPStatus.METHOD_NOT_ALLOWED
            headers = (("Allow", "GET, HEAD"),) if is_method else ()
            return Response(
                refused.status, _sentence(str(refused)), headers=headers
            ).encode()

    def _respond(self, request: HealthRequest) -> Response:
        route = self._routes.get(request.path)
        if route is None:
            known = ", ".join(self._routes)
            return Response(HTTPStatus.NOT_FOUND, _sentence(f"there are {known}"))
        try:
            return route(request)
        except Exception as error:  # noqa: BLE001 (one bad source)
            _log.error("cannot answer", path=request.path, error=repr(error))
            return Response(
                HTTPStatus.INTERNAL_SERVER_ERROR, _sentence(f"{request.path} failed")
            )

    def _metrics(self, request: HealthRequest) -> Response:
        now_ns = self._clock_ns()
        is_openmetrics = "application/openmetrics-text" in request.accept
        rendered_ns, response = self._rendered.get(is_openmetrics, (0, None))
        if response is None or now_ns - rendered_ns >= RENDER_EVERY_S * 1e9:
            body, content_type = self._render(is_openmetrics)
            response = Response(HTTPStatus.OK, body, content_type)
            self._rendered[is_openmetrics] = now_ns, response
        return response

    def _probe(self, verdict: HealthVerdict) -> Response:
        status = HTTPStatus.OK if verdict.ok else HTTPStatus.SERVICE_UNAVAILABLE
        fields = {
            "ok": verdict.ok,
            "state": self._health.state(),
            "reason": verdict.reason,
        }
        return Response(status, json.dumps(fields).encode() + b"\n", "application/json")


def _sentence(reason: str) -> bytes:
    return reason.encode() + b"\n"


async def _linger(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Keep reading for a moment: closing with unread bytes would reset the connection."""
    writer.write_eof()
    try:
        async with time_limit(LINGER_S):
            for _ in range(16):
                if not await reader.read(REQUEST_BYTES_MAX):
                    return
    except TimeoutError:
        pass
