"""The head of a request: what is well-formed is understood, everything else refused."""

import contextlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hilserver.monitoring.health_request import (
    HealthRequest,
    RefusedRequestError,
    parse_request,
)

HOST = b"Host: localhost\r\n"


def test_a_scrape() -> None:
    head = (
        b"GET /metrics?name=x HTTP/1.1\r\n"
        + HOST
        + b"accept: text/plain\r\nX: \t\r\n\r\n"
    )
    assert parse_request(head) == HealthRequest(
        "/metrics", is_head=False, accept="text/plain"
    )


def test_http_1_0_needs_no_host() -> None:
    assert parse_request(b"HEAD / HTTP/1.0\r\n\r\n").is_head


@pytest.mark.parametrize(
    "head",
    [
        b"\r\n\r\n",
        b"GET /metrics\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\n" + HOST + HOST + b"\r\n",
        b"GET /metrics HTTP/2.0\r\n" + HOST + b"\r\n",
        b"GET  /metrics HTTP/1.1\r\n" + HOST + b"\r\n",
        b"get /metrics HTTP/1.1\r\n" + HOST + b"\r\n",
        b"GET http://localhost/metrics HTTP/1.1\r\n" + HOST + b"\r\n",
        b"GET /me\x00trics HTTP/1.1\r\n" + HOST + b"\r\n",
        b"GET /\xc4\x8d HTTP/1.1\r\n" + HOST + b"\r\n",
        b"GET /metrics HTTP/1.1\n" + HOST + b"\r\n",
        b"GET /metrics HTTP/1.1\r\n" + HOST + b"Accept : text/plain\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\n" + HOST + b" folded\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\n" + HOST + b"no colon\r\n\r\n",
        b"GET /metrics HTTP/1.1\r\n" + HOST + b"A: b\nc\r\n\r\n",
    ],
)
def test_what_is_not_plainly_well_formed_is_a_bad_request(head: bytes) -> None:
    with pytest.raises(RefusedRequestError) as refused:
        parse_request(head)
    assert refused.value.status == 400


@pytest.mark.parametrize("method", [b"POST", b"PUT", b"DELETE", b"OPTIONS", b"TRACE"])
def test_other_methods_are_refused(method: bytes) -> None:
    with pytest.raises(RefusedRequestError) as refused:
        parse_request(method + b" /metrics HTTP/1.1\r\n" + HOST + b"\r\n")
    assert refused.value.status == 405


@given(st.binary(max_size=200))
@example(b"GET / HTTP/1.1\r\n:")
def test_no_bytes_raise_anything_else(head: bytes) -> None:
    with contextlib.suppress(RefusedRequestError):
        assert parse_request(head + b"\r\n\r\n").path.startswith("/")


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:9464",
        "127.0.0.1",
        "127.0.0.1:9464",
        "[::1]:9464",
        "192.0.2.1",
        "robot",
    ],
)
def test_our_names_and_every_address_are_answered(host: str) -> None:
    head = f"GET /metrics HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()
    assert parse_request(head, {"localhost", "robot"}).path == "/metrics"


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "", "127.0.0.1.evil", ":80"]
)
def test_another_name_is_misdirected(host: str) -> None:
    head = f"GET /metrics HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()
    with pytest.raises(RefusedRequestError) as refused:
        parse_request(head, {"localhost", "robot"})
    assert refused.value.status == 421
