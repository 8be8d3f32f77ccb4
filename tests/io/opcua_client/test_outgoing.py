"""Outputs of every value into nodes of every numeric type: named or written, never a lost link."""

import asyncio
import contextlib
import math
import struct

import pytest
from asyncua import ua
from asyncua.server import uaprocessor
from asyncua.server.internal_session import InternalSession
from asyncua.ua.ua_binary import struct_to_binary

from hilserver.io.opcua_client import session
from hilserver.io.opcua_client.outgoing import UnfitError, variant
from tests.io.opcua_client.conftest import URI, make_harness, peer_config, wait_until

LIMITS = {
    "SByte": (-(2**7), 2**7 - 1),
    "Byte": (0, 2**8 - 1),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 2**16 - 1),
    "Int32": (-(2**31), 2**31 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (-(2**63), 2**63 - 1),
    "UInt64": (0, 2**64 - 1),
    "Float": (-3.4028234e38, 3.4028234e38),
    "Double": (-1.7976931348623157e308, 1.7976931348623157e308),
    "Boolean": (0, 1),
}
VALUES = (
    *(
        0.0,
        1.0,
        -1.0,
        -40.4,
        0.5,
        127.6,
        255.5,
        1e3,
        65535.6,
        -40000.0,
        1e10,
        -1e10,
        1e19,
        -1e19,
    ),
    *(1e30, 3.4028235677973366e38, -1e39, 1e308, -1.7976931348623157e308, 5e-324),
    *(math.nan, math.inf, -math.inf),
)
SIGNALS = ("wheel.fl.speed_rpm", "wheel.fr.speed_rpm")


@pytest.mark.parametrize("kind", LIMITS)
@pytest.mark.parametrize("value", VALUES)
def test_a_value_is_packed_or_said_not_to_fit(kind, value):
    type_, (low, high) = ua.VariantType[kind], LIMITS[kind]
    is_whole = type_ not in (
        ua.VariantType.Float,
        ua.VariantType.Double,
        ua.VariantType.Boolean,
    )
    fits = math.isfinite(value) and (
        kind == "Boolean" or low <= (round(value) if is_whole else value) <= high
    )
    with contextlib.nullcontext() if fits else pytest.raises(UnfitError):
        made = variant([value], type_)
        assert struct_to_binary(ua.DataValue(made))
        assert fits


def test_what_is_bad_need_not_be_finite():
    made = variant(math.nan, ua.VariantType.Double, is_bad=True)
    assert struct.pack("<d", made.Value) == struct.pack("<d", math.nan)
    with pytest.raises(UnfitError):
        variant(math.nan, ua.VariantType.UInt16, is_bad=True)


@pytest.fixture
def taken(monkeypatch):
    """What arrives at the peer, as its decoder sees it, refused where `refuse` says so."""
    arrived = []
    original = InternalSession.write
    refuse = []

    async def write(self, params):
        results = []
        for item in params.NodesToWrite:
            data = item.Value
            if not str(item.NodeId.Identifier).startswith("rpm_act"):
                results += await original(self, ua.WriteParameters(NodesToWrite=[item]))
                continue
            arrived.append((data.StatusCode, data.SourceTimestamp, data.Value.Value))
            if any(rule(data) for rule in refuse):
                results.append(
                    ua.StatusCode(ua.UInt32(ua.StatusCodes.BadWriteNotSupported))
                )
                continue
            item.Value = ua.DataValue(
                data.Value,
                StatusCode=data.StatusCode or ua.StatusCode(),
                SourceTimestamp=data.SourceTimestamp,
            )
            one = ua.WriteParameters(NodesToWrite=[item])
            results += await original(self, one)
        return results

    monkeypatch.setattr(InternalSession, "write", write)
    tell_what_was_left_out(monkeypatch)
    return arrived, refuse


def tell_what_was_left_out(monkeypatch):
    """Let the peer see that no status came; its library reads one into the gap."""
    decode, make, decoding = uaprocessor.struct_from_binary, ua.DataValue.__init__, []

    def init(self, *args, **fields):
        if decoding and "StatusCode" not in fields:
            fields["StatusCode"] = None
        make(self, *args, **fields)

    def struct_from_binary(*args):
        decoding.append(True)
        try:
            return decode(*args)
        finally:
            decoding.pop()

    monkeypatch.setattr(ua.DataValue, "__init__", init)
    monkeypatch.setattr(uaprocessor, "struct_from_binary", struct_from_binary)


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Let a peer whose answer a busy computer holds up keep its link: it lost none by a value."""
    monkeypatch.setattr(session, "CONNECT_TIMEOUT_S", 60.0)


@contextlib.asynccontextmanager
async def link(peer, nodes):
    write = {s: f"nsu={URI};s={node}" for s, node in zip(SIGNALS, nodes, strict=True)}
    harness = make_harness(peer_config(peer.port, write=write, write_every_ms=10))
    for signal in SIGNALS:
        harness.outputs[signal] = (5.0, 0)
    await harness.link.start()
    keeping = asyncio.create_task(peer.run())
    try:
        await wait_until(lambda: harness.status.writes > 2)
        yield harness
    finally:
        keeping.cancel()
        await harness.link.stop()


@pytest.mark.asyncio(loop_scope="module")
@pytest.mark.parametrize("kind", [k for k in LIMITS if k not in ("Double", "Boolean")])
async def test_one_output_that_does_not_fit_is_a_fault_and_the_rest_goes_on(peer, kind):
    node = f"as_{kind}"
    if node not in peer.nodes:
        await peer.add(node, 0, ua.VariantType[kind])
    async with link(peer, (node, "rpm_act_FR")) as harness:
        for number, value in enumerate((1e39, math.nan, -1e39)):
            harness.outputs[SIGNALS[0]] = (value, 0)
            harness.outputs[SIGNALS[1]] = (number + 1.0, 0)
            writes = harness.status.writes
            await wait_until(lambda before=writes: harness.status.writes > before + 2)
            assert f"unfit_output:{SIGNALS[0]}" in harness.status.faults
            assert (await peer.read("rpm_act_FR")).Value.Value == number + 1.0
            assert (await peer.read(node)).Value.Value == 5
        harness.outputs[SIGNALS[0]] = (7.0, 0)
        writes = harness.status.writes
        await wait_until(lambda: harness.status.writes > writes + 2)
        assert (await peer.read(node)).Value.Value == 7
        assert (harness.status.reconnects, harness.status.last_error) == (0, "")


FORMS = {
    "values only": lambda data: (
        data.StatusCode is not None or data.SourceTimestamp is not None
    ),
    "values with stamps": lambda data: data.StatusCode is not None,
    "values with status": lambda data: data.SourceTimestamp is not None,
}


@pytest.mark.asyncio(loop_scope="module")
@pytest.mark.parametrize("takes", FORMS)
async def test_a_peer_gets_what_it_takes(peer, taken, takes):
    arrived, refuse = taken
    refuse.append(FORMS[takes])
    async with link(peer, ("rpm_act_FL", "rpm_act_FR")) as harness:
        await wait_until(lambda: len(arrived) > 20)
        status, stamp, value = arrived[-1]
        assert (status is None) == (takes != "values with status")
        assert (stamp is None) == (takes != "values with stamps")
        assert value == 5.0
        assert (await peer.read("rpm_act_FL")).Value.Value == 5.0
        assert harness.status.faults == {}
        harness.outputs[SIGNALS[0]] = (9.0, ua.StatusCodes.BadSensorFailure)
        before = len(arrived)
        await wait_until(lambda: len(arrived) > before + 10)
        values = [value for *_, value in arrived]
        # bad never looks like good
        assert (9.0 in values) == (takes == "values with status")
