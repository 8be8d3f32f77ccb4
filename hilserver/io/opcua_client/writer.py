"""Our outputs to the peer's nodes: one multi-write per cycle, never two under way."""

import time
from collections.abc import Callable, Mapping
from datetime import datetime

from asyncua import ua

from hilserver.config.peers import PeerConfig
from hilserver.faults.links import Lane, Line
from hilserver.image.status import GOOD, is_bad
from hilserver.io.opcua_client.acquisition import every
from hilserver.io.opcua_client.session import LinkLostError, Session
from hilserver.io.opcua_client.validation import FaultKind
from hilserver.io.peer_faults import FaultBook
from hilserver.io.peer_status import PeerStatus

LOOK_AGAIN_S = 1.0

Output = tuple[object, int, int]
"""Value, OPC UA status code, CLOCK_MONOTONIC [ns] of the tick that made it."""

_FLOATS = (ua.VariantType.Double, ua.VariantType.Float)
_INTEGERS = (
    ua.VariantType.SByte,
    ua.VariantType.Byte,
    ua.VariantType.Int16,
    ua.VariantType.UInt16,
    ua.VariantType.Int32,
    ua.VariantType.UInt32,
    ua.VariantType.Int64,
    ua.VariantType.UInt64,
)


def variant(value: object, kind: ua.VariantType) -> ua.Variant:
    """Return `value` (number, bool or list of them) as the type that the peer's node has."""
    if kind in _FLOATS:
        convert: Callable[[object], object] = float  # type: ignore[assignment]
    elif kind in _INTEGERS:
        convert = round  # type: ignore[assignment]
    else:
        convert = bool
    converted = [convert(v) for v in value] if isinstance(value, list | tuple) else convert(value)
    return ua.Variant(converted, kind)


class Writer:
    """Writes outputs to one peer for the length of a session."""

    def __init__(
        self,
        session: Session,
        config: PeerConfig,
        status: PeerStatus,
        faults: FaultBook,
        read_output: Callable[[str], Output],
        utc: Callable[[int], datetime],
        lane: Lane[tuple[list[str], ua.WriteParameters]] | None = None,
    ) -> None:
        self._session = session
        self._config = config
        self._status = status
        self._faults = faults
        self._read_output = read_output
        self._utc = utc
        self._lane = lane or Lane(Line(config.name), "out")
        self._targets: dict[str, tuple[ua.NodeId, ua.VariantType]] = {}
        self._bare: set[str] = set()
        self._look_again_s = 0.0

    async def run(self) -> None:
        """Write every cycle until the session ends."""
        if self._config.write:
            await every(self._config.write_every_ms / 1000, self._cycle, self._skipped)

    def _skipped(self, count: int) -> None:
        self._status.writes_skipped += count

    async def _cycle(self) -> None:
        if len(self._targets) < len(self._config.write) and time.monotonic() >= self._look_again_s:
            await self._find_targets()
            self._look_again_s = time.monotonic() + LOOK_AGAIN_S
        try:
            outputs = {signal: self._read_output(signal) for signal in self._targets}
        except LookupError:
            return  # no tick has made a value yet
        if self._config.write_status == "good":
            outputs = {
                s: (value, GOOD, ns) for s, (value, code, ns) in outputs.items() if not is_bad(code)
            }
        if not outputs:
            return
        signals, request = list(outputs), ua.WriteParameters()
        request.NodesToWrite = [self._value(signal, outputs[signal]) for signal in signals]
        self._lane.put((signals, request))
        for named, due in self._lane.take():
            await self._send(named, due)

    async def _send(self, signals: list[str], request: ua.WriteParameters) -> None:
        results = await self._session.services.write(request)
        if len(results) != len(signals):
            raise LinkLostError("the peer answered a write with another number of results")
        self._status.writes += 1
        for signal, result in zip(signals, results, strict=True):
            if not result.is_good() and signal in self._targets:
                self._on_refused(signal, result)

    def _value(self, signal: str, output: Output) -> ua.WriteValue:
        node, kind = self._targets[signal]
        value, status, monotonic_ns = output
        data = ua.DataValue(variant(value, kind))
        if signal not in self._bare:
            data = ua.DataValue(
                variant(value, kind),
                StatusCode=ua.StatusCode(ua.UInt32(status)),
                SourceTimestamp=self._utc(monotonic_ns),
            )
        return ua.WriteValue(NodeId=node, AttributeId=ua.AttributeIds.Value, Value=data)

    def _on_refused(self, signal: str, result: ua.StatusCode) -> None:
        node = self._config.write[signal]
        if result.value == ua.StatusCodes.BadWriteNotSupported and signal not in self._bare:
            # Part 4 allows a server to take values only: it then gets neither stamp nor status.
            self._bare.add(signal)
            return
        if result.value == ua.StatusCodes.BadNodeIdUnknown:
            del self._targets[signal]
        sentence = f"{node} refuses {signal}: {result.name}"
        self._faults.report(FaultKind.REFUSED_WRITE, node, sentence, time.monotonic_ns())

    async def _find_targets(self) -> None:
        wanted: Mapping[str, str] = {
            signal: node
            for signal, node in self._config.write.items()
            if signal not in self._targets
        }
        resolved = await self._session.resolve(wanted.values())
        known = [(signal, resolved[node]) for signal, node in wanted.items()]
        found = [(signal, node) for signal, node in known if node is not None]
        types = await self._session.read_attributes(
            [node for _, node in found], ua.AttributeIds.DataType
        )
        kinds = {
            signal: (node, type_)
            for (signal, node), type_ in zip(found, types, strict=True)
            if type_ is not None
        }
        now_ns = time.monotonic_ns()
        for signal, node in wanted.items():
            if signal not in kinds:
                sentence = f"{node} is not there, so {signal} is not written"
                self._faults.report(FaultKind.MISSING_NODE, node, sentence, now_ns)
                continue
            kind = _variant_type(kinds[signal][1])
            if kind is None:
                sentence = f"{node} is no number, so {signal} is not written"
                self._faults.report(FaultKind.REFUSED_WRITE, node, sentence, now_ns)
                continue
            self._targets[signal] = (kinds[signal][0], kind)


def _variant_type(data_type: ua.NodeId) -> ua.VariantType | None:
    """Return the built-in type of a DataType node; abstract Number (26) is served as Double."""
    if data_type.NamespaceIndex != 0 or not isinstance(data_type.Identifier, int):
        return None
    if data_type.Identifier in (24, 26):
        return ua.VariantType.Double
    for kind in (*_FLOATS, *_INTEGERS, ua.VariantType.Boolean):
        if kind.value == data_type.Identifier:
            return kind
    return None
