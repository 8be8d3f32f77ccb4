"""Deadlines of the handshake: short for strangers, long for programs of our own user."""

import socket
from types import SimpleNamespace

import pytest

from hilserver.opcua.frames import ConnectionStage
from hilserver.opcua.loopback import is_own_program, owner_of
from hilserver.opcua.transport import (
    BUSY_DEADLINE_S,
    LOGIN_DEADLINE_S,
    READ_DEADLINE_S,
    Connection,
)

LISTED = "   1: 0100007F:9C40 0100007F:12E8 01 00000000:00000000 00:00000000 00000000  1001   0 77"
LISTED_6 = (
    "   2: 00000000000000000000000001000000:9C40 00000000000000000000000001000000:12E8 01"
    " 00000000:00000000 00:00000000 00000000  1002   0 78"
)


@pytest.mark.parametrize(
    ("host", "port", "owner"),
    [("127.0.0.1", 40000, 1001), ("::1", 40000, 1002), ("::1", 1, None)],
)
def test_the_owner_of_a_socket_is_in_the_kernels_table(host, port, owner):
    assert owner_of((host, port), (host, 4840), ["header", LISTED, LISTED_6]) == owner


def test_our_own_connection_is_ours():
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as client,
    ):
        assert is_own_program(client.getsockname(), server.getsockname())
        assert not is_own_program(client.getsockname(), ("127.0.0.1", 1))


STAGES = [
    (ConnectionStage.NEW, READ_DEADLINE_S),
    (ConnectionStage.OPEN, LOGIN_DEADLINE_S),
]


def stays_too_long(stage, stayed_s, *, is_own=False, waits=()):
    """Return what a connection judges that has been in this stage for so long."""
    connection = SimpleNamespace(
        processor=SimpleNamespace(stage=stage),
        _stage_since_s=100.0,
        _frames=waits,
        _work=None,
        _waiting=None,
        _is_of_our_user=lambda: is_own,
    )
    return Connection._stays_too_long(connection, 100.0 + stayed_s)


@pytest.mark.parametrize(("stage", "deadline_s"), STAGES)
def test_a_stranger_has_the_short_deadline(stage, deadline_s):
    assert not stays_too_long(stage, deadline_s - 0.5)
    assert stays_too_long(stage, deadline_s + 0.5)


@pytest.mark.parametrize(("stage", "deadline_s"), STAGES)
@pytest.mark.parametrize("why", [{"is_own": True}, {"waits": ("a frame",)}])
def test_programs_of_our_user_and_whoever_waits_for_us_have_longer(
    stage, deadline_s, why
):
    assert not stays_too_long(stage, deadline_s + 0.5, **why)
    assert not stays_too_long(stage, BUSY_DEADLINE_S - 1.0, **why)
    assert stays_too_long(stage, BUSY_DEADLINE_S + 1.0, **why)
