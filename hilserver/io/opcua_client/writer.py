"""Our outputs to the peer's nodes: one multi-write per cycle, never two under way."""

import time
from collections.abc import Callable, Mapping
from datetime import datetime

from asyncua import ua

from hilserver.config.peers import PeerConfig
from hilserver.faults.links import Lane, PeerLine
from hilserver.io.link_status import FaultBook, PeerStatus
from hilserver.io.opcua_client.outgoing import (
    SentForm,
    UnfitError,
    data_value,
    variant,
    variant_type,
)
from hilserver.io.opcua_client.session import PeerSession
from hilserver.io.peer_link.link import Output
from hilserver.io.peer_link.samples import FaultKind, LinkLostError
from hilserver.period import every
from hilserver.status import GOOD, is_bad

LOOK_AGAIN_S = 1.0


class PeerWriter:
    """Writes outputs to one peer during a session."""

    def __init__(
        self,
        session: PeerSession,
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
        self._lane = lane or Lane(PeerLine(config.name), "out")
        self._targets: dict[str, tuple[ua.NodeId, ua.VariantType]] = {}
        self._forms: dict[str, SentForm] = {}
        self._look_again_s = 0.0

    async def run(self) -> None:
        """Write every cycle until the session ends."""
        await every(self._config.write_every_ms / 1000, self._cycle, self._skipped)

    def _skipped(self, count: int) -> None:
        self._status.writes_skipped += count

    async def _cycle(self) -> None:
        are_some_missing = len(self._targets) < len(self._config.write)
        if are_some_missing and time.monotonic() >= self._look_again_s:
            await self._find_targets()
            self._look_again_s = time.monotonic() + LOOK_AGAIN_S
        try:
            outputs = {signal: self._read_output(signal) for signal in self._targets}
        except LookupError:
            return  # no tick has produced a value yet
        values = [
            value for s, output in outputs.items() if (value := self._value(s, output))
        ]
        if not values:
            return
        signals = [signal for signal, _ in values]
        request = ua.WriteParameters()
        request.NodesToWrite = [value for _, value in values]
        self._lane.put((signals, request))
        for named, due in self._lane.take():
            results = await self._session.services.write(due)
            if len(results) != len(named):
                raise LinkLostError(
                    "the peer answered a write with the wrong number of results"
                )
            self._status.writes += 1
            for written, result in zip(named, results, strict=True):
                if not result.is_good() and written in self._targets:
                    self._on_refused(written, result)

    def _value(self, signal: str, output: Output) -> tuple[str, ua.WriteValue] | None:
        """Return what is written for a signal now; None if nothing can be."""
        node, kind = self._targets[signal]
        value, status, monotonic_ns = output
        form = self._forms.get(signal, SentForm.WHOLE)
        address = self._config.write[signal]
        is_honest = self._config.write_status == "honest"
        if is_bad(status) and not (is_honest and form.has_status):
            return None  # without its status it would pass for a good value
        try:
            fitted = variant(value, kind, is_bad=is_bad(status))
        except UnfitError as error:
            sentence = f"{signal} is not written to {address}: {error}"
            self._faults.report(
                FaultKind.UNFIT_OUTPUT, signal, sentence, time.monotonic_ns()
            )
            return None
        data = data_value(
            fitted, form, status if is_honest else GOOD, self._utc(monotonic_ns)
        )
        return signal, ua.WriteValue(
            NodeId=node, AttributeId=ua.AttributeIds.Value, Value=data
        )

    def _on_refused(self, signal: str, result: ua.StatusCode) -> None:
        node = self._config.write[signal]
        form = self._forms.get(signal, SentForm.WHOLE)
        if (
            result.value == ua.StatusCodes.BadWriteNotSupported
            and form is not SentForm.BARE
        ):
            self._forms[signal] = SentForm(form + 1)
            return
        if result.value == ua.StatusCodes.BadNodeIdUnknown:
            del self._targets[signal]
        sentence = f"{node} refuses {signal}: {result.name}"
        self._faults.report(
            FaultKind.REFUSED_WRITE, node, sentence, time.monotonic_ns()
        )

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
                sentence = f"{node} does not exist, so {signal} is not written"
                self._faults.report(FaultKind.MISSING_NODE, node, sentence, now_ns)
                continue
            kind = variant_type(kinds[signal][1])
            if kind is None:
                sentence = f"{node} is not numeric, so {signal} is not written"
                self._faults.report(FaultKind.REFUSED_WRITE, node, sentence, now_ns)
                continue
            self._targets[signal] = (kinds[signal][0], kind)
