"""The endpoint over real sockets: scrapes, probes, and clients that mean no good."""

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncIterator, Callable

import pytest
import uvloop

from hilserver.errors import FailedError
from hilserver.monitoring.health_http import (
    CONNECTIONS_MAX,
    REQUEST_BYTES_MAX,
    HealthSources,
    HttpServer,
)
from hilserver.monitoring.metrics import Metrics
from hilserver.signals import State
from tests.helpers.prom_diff import PromDiff, series_of_text
from tests.monitoring.figures import FakeDaemon

TIMEOUT_S = 0.2


class Endpoint:
    """A server on a free port with a clock and figures that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.heartbeat_ns = 10**9
        self.first_ticks_met = True
        self.tasks_down = ""
        self.daemon = FakeDaemon()
        self.daemon.state = State.RUNNING
        metrics = Metrics(*self.daemon.sources())
        self.server = HttpServer(
            port=0,
            render=metrics.render,
            health=HealthSources(
                state=lambda: self.daemon.state.word,
                heartbeat_ns=lambda: self.heartbeat_ns,
                first_ticks_met=lambda: self.first_ticks_met,
                tasks_down=lambda: self.tasks_down,
            ),
            timeout_s=TIMEOUT_S,
            clock_ns=lambda: self.now_ns,
        )

    async def send(self, request: bytes) -> tuple[int, dict[str, str], bytes]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.server.port)
        writer.write(request)
        answer = await asyncio.wait_for(reader.read(), 5)
        writer.close()
        return split(answer)

    async def get(self, path: str, *headers: str) -> tuple[int, dict[str, str], bytes]:
        lines = [f"GET {path} HTTP/1.1", "Host: localhost", *headers, "", ""]
        return await self.send("\r\n".join(lines).encode())


def split(answer: bytes) -> tuple[int, dict[str, str], bytes]:
    head, _, body = answer.partition(b"\r\n\r\n")
    status, *lines = head.decode("latin-1").split("\r\n")
    return int(status.split()[1]), dict(line.split(": ", 1) for line in lines), body


async def closed_without_answer(reader: asyncio.StreamReader) -> bool:
    try:
        return await asyncio.wait_for(reader.read(), 5) == b""
    except ConnectionError:
        return True


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop turn until `condition` holds, for 5 s at most."""
    async with asyncio.timeout(120):
        while not condition():  # noqa: ASYNC110 (the server has no event for it, nor needs one)
            await asyncio.sleep(0.001)


@pytest.fixture
async def endpoint() -> AsyncIterator[Endpoint]:
    endpoint = Endpoint()
    await endpoint.server.start()
    yield endpoint
    await endpoint.server.stop()


async def test_scrape_in_both_formats(endpoint: Endpoint) -> None:
    status, headers, body = await endpoint.get("/metrics")
    assert status == 200
    assert headers["Content-Type"].startswith("text/plain; version=0.0.4")
    assert int(headers["Content-Length"]) == len(body)
    assert headers["Connection"] == "close"
    assert (
        series_of_text(body.decode())["hil_state", frozenset({("state", "running")})]
        == 1
    )

    accept = "Accept: application/openmetrics-text;version=1.0.0;q=0.5,text/plain;q=0.3"
    _, headers, body = await endpoint.get("/metrics", accept)
    assert headers["Content-Type"].startswith(
        "application/openmetrics-text; version=1.0.0"
    )
    assert body.endswith(b"# EOF\n")


async def test_a_scrape_over_http_shows_what_moved(endpoint: Endpoint) -> None:
    before = (await endpoint.get("/metrics"))[2].decode()
    endpoint.daemon.end_to_end.observe(30_000_000)
    endpoint.now_ns += 10**9
    after = (await endpoint.get("/metrics"))[2].decode()
    texts = iter([before, after])
    with PromDiff(lambda: next(texts)) as diff:
        pass
    assert diff["hil_end_to_end_seconds_bucket", {"le": "0.05"}] == 1
    assert diff["hil_end_to_end_seconds_bucket", {"le": "0.02"}] == 0


async def test_a_flood_of_scrapes_is_rendered_once_per_interval(
    endpoint: Endpoint,
) -> None:
    await endpoint.get("/metrics")
    endpoint.daemon.state = State.PAUSED
    endpoint.now_ns += 49_000_000
    stale = (await endpoint.get("/metrics"))[2]
    endpoint.now_ns += 1_000_000
    fresh = (await endpoint.get("/metrics"))[2]
    assert b'hil_state{state="paused"} 0.0' in stale
    assert b'hil_state{state="paused"} 1.0' in fresh


async def test_probes_answer_with_status_and_reason(endpoint: Endpoint) -> None:
    for path in ("/healthz", "/readyz"):
        status, headers, body = await endpoint.get(path)
        assert (status, headers["Content-Type"]) == (200, "application/json")
        assert json.loads(body)["ok"] is True

    endpoint.daemon.state = State.SAFE
    assert (await endpoint.get("/healthz"))[0] == 200
    status, _, body = await endpoint.get("/readyz")
    assert status == 503
    assert json.loads(body) == {
        "ok": False,
        "state": "safe",
        "reason": "the state is safe, not running",
    }


async def test_healthz_fails_when_the_pacing_freezes(endpoint: Endpoint) -> None:
    endpoint.now_ns += 5 * 10**9
    status, _, body = await endpoint.get("/healthz")
    assert status == 503
    assert "5.0 s ago" in json.loads(body)["reason"]


async def test_head_has_the_length_but_no_body(endpoint: Endpoint) -> None:
    status, headers, body = await endpoint.send(b"HEAD /metrics HTTP/1.0\r\n\r\n")
    assert (status, body) == (200, b"")
    assert int(headers["Content-Length"]) > 1000


async def test_unknown_path_names_the_known_ones(endpoint: Endpoint) -> None:
    status, _, body = await endpoint.get("/metrics/../etc/passwd")
    assert status == 404
    assert b"/metrics, /healthz, /readyz" in body


async def test_malformed_requests_and_methods(endpoint: Endpoint) -> None:
    assert (await endpoint.send(b"\x16\x03\x01\x02\x00\r\n\r\n"))[0] == 400
    assert (await endpoint.get("/healthz", "no header"))[0] == 400
    post = b"POST /metrics HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc"
    status, headers, _ = await endpoint.send(post)
    assert (status, headers["Allow"]) == (405, "GET, HEAD")


async def test_oversized_request_is_refused_and_the_server_goes_on(
    endpoint: Endpoint,
) -> None:
    head = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nX: "
    assert (await endpoint.send(head + b"a" * REQUEST_BYTES_MAX))[0] == 431
    assert (await endpoint.get("/healthz"))[0] == 200


async def test_a_client_that_never_finishes_is_told_and_closed(
    endpoint: Endpoint,
) -> None:
    assert (await endpoint.send(b"GET /metrics HTTP/1.1\r\n"))[0] == 408


async def test_a_client_that_goes_away_leaves_nothing_behind(
    endpoint: Endpoint,
) -> None:
    for request in (b"", b"GET /met", b"GET /metrics HTTP/1.0\r\n\r\n"):
        _, writer = await asyncio.open_connection("127.0.0.1", endpoint.server.port)
        writer.write(request)
        writer.transport.abort()
    assert (await endpoint.get("/healthz"))[0] == 200
    await until(lambda: not endpoint.server._open)


async def test_a_client_that_does_not_read_is_dropped() -> None:
    endpoint = Endpoint()
    server = HttpServer(
        port=0,
        render=lambda _: (
            b"x" * 20_000_000,
            "text/plain",
        ),  # more than any socket buffers
        health=endpoint.server._health,
        timeout_s=TIMEOUT_S,
    )
    await server.start()
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", server.port, limit=1)
        writer.write(b"GET /metrics HTTP/1.0\r\n\r\n")
        await writer.drain()
        await until(lambda: len(server._open) == 1)
        await until(lambda: len(server._open) == 0)
        writer.transport.abort()
    finally:
        await server.stop()


async def drip(port: int) -> None:
    """Send a request byte by byte, and again on a new connection when the server has closed."""
    for _ in range(50):
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        with contextlib.closing(writer.transport), contextlib.suppress(OSError):
            for byte in b"GET /healthz HTTP/1.1\r\nX: " + b"a" * 200:
                writer.write(bytes((byte,)))
                await asyncio.sleep(0.05)
                await writer.drain()
        await asyncio.sleep(0.1)


async def test_dripping_clients_do_not_keep_a_probe_out(endpoint: Endpoint) -> None:
    """All places are taken by requests that never end: the oldest makes room."""
    endpoint.server._timeout_s = 30
    async with asyncio.TaskGroup() as group:
        drips = [
            group.create_task(drip(endpoint.server.port))
            for _ in range(CONNECTIONS_MAX + 8)
        ]
        await until(lambda: len(endpoint.server._open) == CONNECTIONS_MAX)
        statuses = [(await endpoint.get("/healthz"))[0] for _ in range(10)]
        for task in drips:
            task.cancel()
    assert statuses == [200] * 10


async def test_a_page_of_another_name_learns_nothing(endpoint: Endpoint) -> None:
    request = b"GET /metrics HTTP/1.1\r\nHost: rebound.example:9464\r\n\r\n"
    status, _, body = await endpoint.send(request)
    assert status == 421
    assert b"metrics.host_names" in body
    assert b"hil_" not in body
    endpoint.server._names.add("rebound.example")
    assert (await endpoint.send(request))[0] == 200


async def test_a_broken_source_is_an_error_of_its_page_only(endpoint: Endpoint) -> None:
    del endpoint.daemon.slices
    status, _, body = await endpoint.get("/metrics")
    assert (status, body) == (500, b"/metrics failed\n")
    assert (await endpoint.get("/healthz"))[0] == 200


async def test_port_in_use_is_one_sentence_with_its_mend(endpoint: Endpoint) -> None:
    second = Endpoint().server
    second.port = endpoint.server.port
    with pytest.raises(FailedError) as failed:
        await second.start()
    sentence = str(failed.value)
    assert f"port {second.port} (address already in use)" in sentence
    assert sentence.startswith("metrics: ")
    assert "choose another port" in sentence
    assert "\n" not in sentence
    await second.stop()  # was never started: nothing to do


async def test_foreign_address_is_one_sentence() -> None:
    server = Endpoint().server
    server.host = "192.0.2.1"
    with pytest.raises(
        FailedError, match=r"^metrics: .* use an address of this computer"
    ):
        await server.start()


async def test_listens_on_loopback_only(endpoint: Endpoint) -> None:
    listeners = endpoint.server._server.sockets
    assert [listener.getsockname()[0] for listener in listeners] == ["127.0.0.1"]


async def test_stop_ends_open_connections_and_frees_the_port() -> None:
    endpoint = Endpoint()
    await endpoint.server.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", endpoint.server.port)
    writer.write(b"GET /hea")
    await writer.drain()
    await until(lambda: len(endpoint.server._open) == 1)
    await endpoint.server.stop()
    assert await closed_without_answer(reader)
    writer.transport.abort()
    with socket.socket() as free:
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        free.bind(("127.0.0.1", endpoint.server.port))


def test_the_url_of_an_ipv6_address_has_brackets() -> None:
    server = Endpoint().server
    server.host, server.port = "::1", 9464
    assert server.url == "http://[::1]:9464/metrics"


def test_the_same_on_uvloop() -> None:
    """The daemon's loop has transports of its own."""

    async def scenario() -> None:
        endpoint = Endpoint()
        await endpoint.server.start()
        await test_scrape_in_both_formats(endpoint)
        await test_malformed_requests_and_methods(endpoint)
        await test_oversized_request_is_refused_and_the_server_goes_on(endpoint)
        await test_a_client_that_never_finishes_is_told_and_closed(endpoint)
        await test_dripping_clients_do_not_keep_a_probe_out(endpoint)
        await test_port_in_use_is_one_sentence_with_its_mend(endpoint)
        await endpoint.server.stop()
        await test_a_client_that_does_not_read_is_dropped()
        await test_stop_ends_open_connections_and_frees_the_port()

    uvloop.run(scenario())


async def test_not_ready_while_a_task_does_not_run(endpoint: Endpoint) -> None:
    assert (await endpoint.get("/readyz"))[0] == 200
    endpoint.tasks_down = "task 'edge' returned"
    status, _, body = await endpoint.get("/readyz")
    assert (status, b"task 'edge' returned" in body) == (503, True)
