"""The transport: frames out of a stream, deadlines, room for those who behave."""

import asyncio
import itertools
import struct
import time

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.ua.ua_binary import variant_from_binary, variant_to_binary
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.wire import Wire, frame, hello
from hilserver.opcua.decoding import bound_decoder, within_bounds
from hilserver.opcua.frames import (
    ConnectionStage,
    FrameReader,
    TransportError,
    check_order,
)
from tests.io.opcua_server.rig import Rig, RobotClient
from tests.security.pki import Pki

pytestmark = pytest.mark.asyncio(loop_scope="module")
FRAMES = st.lists(
    st.binary(min_size=24, max_size=80).map(lambda body: frame(b"MSG", body)),
    max_size=8,
)


@given(frames=FRAMES, cuts=st.lists(st.integers(0, 500), max_size=10))
async def test_frames_come_out_whole_however_they_come_in(
    frames: list[bytes], cuts: list[int]
) -> None:
    stream, reader, found = b"".join(frames), FrameReader(), []
    places = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    for begin, end in itertools.pairwise(places):
        found += [data for _, data in reader.feed(stream[begin:end], 1.0)]
    assert found == frames
    assert reader.since_s is None


MESSAGES = st.builds(
    lambda kind, length, body: kind + b"F" + struct.pack("<I", length) + body,
    st.sampled_from([b"HEL", b"OPN", b"MSG", b"CLO", b"ERR", b"XYZ"]),
    st.integers(0, 100) | st.integers(0, 2**32 - 1),
    st.binary(max_size=100),
)


@given(data=MESSAGES | st.lists(MESSAGES, max_size=4).map(b"".join))
async def test_nothing_but_messages_is_kept(data: bytes) -> None:
    reader = FrameReader()
    try:
        for kind, whole in reader.feed(data, 1.0):
            assert kind in (b"HEL", b"OPN", b"MSG", b"CLO", b"ERR")
            assert len(whole) == struct.unpack_from("<I", whole, 4)[0] <= 65_535
    except TransportError:
        return
    assert len(reader._buffer) < 65_535


@pytest.mark.parametrize(
    ("stage", "allowed"),
    [
        (ConnectionStage.NEW, {b"HEL"}),
        (ConnectionStage.GREETED, {b"OPN"}),
        (ConnectionStage.OPEN, {b"OPN", b"MSG", b"CLO"}),
    ],
)
async def test_order(stage: ConnectionStage, allowed: set[bytes]) -> None:
    for kind in (b"HEL", b"OPN", b"MSG", b"CLO", b"ERR"):
        if kind in allowed:
            check_order(stage, kind)
        else:
            with pytest.raises(TransportError):
                check_order(stage, kind)


async def silence(rig: Rig, *said: bytes) -> tuple[str, float]:
    """Say something and wait; return the status code and after how long it came."""
    async with Wire(rig.server.url) as wire:
        for data in said:
            await wire.send(data)
            if data[:3] == b"HEL" and len(data) > 40:
                await wire.receive()
        began = time.monotonic()
        kind, body = await wire.receive(within_s=10)
        assert kind == b"ERR"
        return ua.StatusCode(
            struct.unpack_from("<I", body)[0]
        ).name, time.monotonic() - began


@pytest.mark.parametrize(
    "case", ["nothing", "half a hello", "no channel", "half a channel"]
)
async def test_who_does_not_go_on_is_closed(ours: Rig, case: str) -> None:
    greeting = hello(ours.server.url)
    said = {
        "nothing": (),
        "half a hello": (greeting[:20],),
        "no channel": (greeting,),
        "half a channel": (greeting, frame(b"OPN", b"\0" * 30, size=200)),
    }[case]
    code, waited_s = await silence(ours, *said)
    assert code == "BadTimeout"
    assert waited_s < 5.0


async def test_tiny_buffers_are_refused(ours: Rig) -> None:
    async with Wire(ours.server.url) as wire:
        await wire.send(hello(ours.server.url, buffer_bytes=1))
        kind, body = await wire.receive()
    code = ua.StatusCode(struct.unpack_from("<I", body)[0]).name
    assert (kind, code) == (b"ERR", "BadConnectionRejected")


async def test_idle_sockets_make_room_for_a_client(pki: Pki, tmp_path: object) -> None:
    rig = Rig(tmp_path, max_connections=5, **pki.config())
    await rig.server.start()
    wires = [Wire(rig.server.url) for _ in range(12)]
    try:
        for wire in wires:
            await wire.__aenter__()
        async with await pki.secure(RobotClient(rig.server.url)) as client:
            assert await client.read("audit.opcua_access") is True
            assert len(rig.server._server.bserver.clients) <= 5
    finally:
        for wire in wires:
            wire.abort()
        await asyncio.sleep(0.05)
        assert not rig.server._server.iserver.asyncio_transports
        await rig.close()


@pytest.mark.parametrize(
    ("kind", "element", "most"),
    [
        (ua.VariantType.Variant, ua.Variant(), 2000),
        (ua.VariantType.LocalizedText, ua.LocalizedText("x"), 2000),
        (ua.VariantType.DataValue, ua.DataValue(), 500),
        (ua.VariantType.ExtensionObject, ua.Range(1.0, 2.0), 500),
        (ua.VariantType.Double, 1.0, 20_000),
    ],
)
async def test_what_one_operation_carries_is_bounded_by_what_it_costs(
    kind: ua.VariantType, element: object, most: int
) -> None:
    bound_decoder()

    def decode(count: int) -> list[object]:
        body = Buffer(
            variant_to_binary(ua.Variant([element] * count, kind, is_array=True))
        )
        return within_bounds(lambda: variant_from_binary(body)).Value

    assert len(decode(most)) == most
    if kind != ua.VariantType.Double:
        with pytest.raises(ServiceError) as error:
            decode(most + 1)
        assert error.value.code == ua.StatusCodes.BadEncodingLimitsExceeded
        peers = Buffer(
            variant_to_binary(ua.Variant([element] * 5000, kind, is_array=True))
        )
        assert len(variant_from_binary(peers).Value) == 5000, (
            "what our own peers send has no bound"
        )
