"""From samples to one group for the input gate: judged, counted, named, handed over together.

Every group is the complete picture of what the peer commands, not only the changes: after a
hand-over of control or a reset the next cycle brings a constant set-point again. If the peer has a
counter, a batch without a newer number is not handed over.
"""

import asyncio
import time
from collections.abc import Callable, Iterable

from hilserver.config.peers import PeerConfig
from hilserver.faults.links import Lane, PeerLine
from hilserver.io.peer_link.latency import ClockOffset, StampWatch, one_way_ns
from hilserver.io.peer_link.samples import FaultKind, SampleVerdict, SequenceWatch
from hilserver.io.source import Source

SEQUENCE_SIGNAL = "input.sequence"

REPEATS_TOLERATED = 3
"""Batches with changed values under one sequence number before that counts as a fault."""
OLDEST_NS = 1_000_000_000  # a sample older than that by its stamp has a wrong stamp


class Intake:
    """Takes the batches of one peer, by whatever transport.

    `utc_ns`: CLOCK_MONOTONIC [ns] -> UTC [ns].
    """

    def __init__(
        self, config: PeerConfig, source: Source, utc_ns: Callable[[int], int]
    ) -> None:
        self._inputs = {node: config.inputs_of(node) for node in config.read}
        self._counter = config.counter
        self._stamped_node = config.counter
        self._modulus = config.counter_modulus
        self._sends_sequence = SEQUENCE_SIGNAL not in config.inputs
        self._source = source
        self._status = source.status
        self._staleness = source.staleness
        self._faults = source.faults
        self._utc_ns = utc_ns
        # newest number of the counter, of whichever session
        self._counted: int | None = None
        self.begin_session()

    def begin_session(self) -> None:
        """Forget what holds only within one session: counters, stamps and values."""
        self.sequence = SequenceWatch(self._modulus)
        self.offset = ClockOffset()
        self._stamps = StampWatch()
        self._picture: dict[str, object] = {}
        self._refused: dict[str, object] = {}
        self._last_values: dict[str, object] = {}
        self._news_ns: int | None = None
        self._repeats = 0
        self._fresh: set[str] = set()  # inputs with a new sample
        self._age_ns = 0  # of the newest batch, by the stamp of its source

    def expect(self, nodes: Iterable[str], now_ns: int) -> None:
        """Treat every input as unusable until its first good sample."""
        for node in nodes:
            self._lose(node, now_ns)

    def missing(self, node: str, why: str, now_ns: int) -> None:
        """Report a node that the peer does not have (yet)."""
        self._faults.report(
            FaultKind.MISSING_NODE, node, f"{node} does not exist: {why}", now_ns
        )
        self._drop(node, now_ns)

    def receive(
        self, samples: Iterable[tuple[str, SampleVerdict]], now_ns: int
    ) -> None:
        """Take one batch that arrived at `now_ns` (CLOCK_MONOTONIC).

        Parameters
        ----------
        samples : iterable of (node, Verdict)
            Oldest first; empty for a keep-alive, which attests that nothing changed.
        """
        advanced = self._counter is None
        news = changed = False
        self._age_ns = 0
        for node, verdict in samples:
            is_new, has_changed = self._compare(node, verdict)
            self._judge_stamp(node, verdict, now_ns)
            news |= is_new
            if verdict.fault is not None:
                sentence = f"{node}: {verdict.detail}"
                self._faults.report(verdict.fault, node, sentence, now_ns)
                self._drop(node, now_ns)
                continue
            for name in self._inputs.get(node, (node,)):
                self._staleness.usable(name)
            if node == self._counter:
                advanced |= self._count(verdict, now_ns)
            else:
                changed |= has_changed
            for name in self._inputs.get(node, ()):
                self._keep(name, verdict.value)
                if is_new:
                    self._fresh.add(name)
        if news:
            if self._news_ns is not None:
                self._status.interval.observe(now_ns - self._news_ns)
            self._news_ns = now_ns
        if advanced:
            self._repeats = 0
            self._hand_over(now_ns)
        elif changed:
            self._watch_repeats(now_ns)

    def _compare(self, node: str, verdict: SampleVerdict) -> tuple[bool, bool]:
        """Return (value or stamp is new, value has changed) and remember both."""
        before = self._last_values.get(node)
        value = verdict.value
        now = (verdict.stamp_ns, value)
        self._last_values[node] = now
        if not isinstance(before, tuple):
            return True, False
        return now != before, value is not None and value != before[1]

    def _keep(self, signal: str, value: object) -> None:
        if signal in self._refused and self._refused[signal] == value:
            return
        self._refused.pop(signal, None)
        self._picture[signal] = value

    def _drop(self, node: str, now_ns: int) -> None:
        for name in self._inputs.get(node, ()):
            self._picture.pop(name, None)
        self._lose(node, now_ns)

    def _lose(self, node: str, now_ns: int) -> None:
        for name in self._inputs.get(node, (node,)):
            self._staleness.unusable(name, now_ns)

    def _count(self, verdict: SampleVerdict, now_ns: int) -> bool:
        value = verdict.value
        if not isinstance(value, int | float) or value != int(value):
            sentence = f"{self._counter}: {value!r} is not a counter value"
            self._faults.report(
                FaultKind.SEQUENCE_JUMP, str(self._counter), sentence, now_ns
            )
            return False
        before = self.sequence.last
        number = int(value) % self._modulus
        # A controller that hangs says the same again in every session: nothing of it is new.
        is_old = before is None and number == self._counted
        self._counted = number
        step = self.sequence.observe(number)
        if step.fault is not None:
            sentence = f"the sequence counter jumped from {before} to {int(value)}"
            self._faults.report(step.fault, str(self._counter), sentence, now_ns)
        if step.advanced and not is_old:
            self._status.sequence_received += 1
            self._status.sequence_missed += step.missed
            if self._sends_sequence:
                self._picture[SEQUENCE_SIGNAL] = int(value) % 2**32
        return step.advanced and not is_old

    def _judge_stamp(self, node: str, verdict: SampleVerdict, now_ns: int) -> None:
        stamp_ns = verdict.stamp_ns
        stamp = self._stamps.observe(node, stamp_ns, verdict.value)
        if stamp.fault is not None:
            did = "went backwards"
            if stamp.fault is FaultKind.FROZEN_STAMP:
                did = "stands still while values change"
            sentence = f"the SourceTimestamp of {node} {did}"
            self._faults.report(stamp.fault, node, sentence, now_ns)
        counts = self._stamped_node in (None, node)
        offset_ns = self.offset.offset_ns
        if not (stamp.advanced and counts) or stamp_ns is None or offset_ns is None:
            return
        latency_ns = one_way_ns(stamp_ns, self._utc_ns(now_ns), offset_ns)
        tolerance_ns = 1_000_000 + (self.offset.uncertainty_ns or 0)
        if latency_ns < -tolerance_ns:
            sentence = (
                f"the SourceTimestamp of {node} is {-latency_ns / 1e6:.0f} ms ahead"
            )
            self._faults.report(FaultKind.STAMP_AHEAD, node, sentence, now_ns)
            return
        self._status.one_way.observe(max(latency_ns, 0))
        self._age_ns = max(latency_ns, 0) if latency_ns < OLDEST_NS else 0

    def _hand_over(self, now_ns: int) -> None:
        self._staleness.renew(now_ns)
        self._status.input_received_ns.update(dict.fromkeys(self._picture, now_ns))
        if not self._picture or self._staleness.waiting:
            return
        renews = not self._staleness.lacks_input
        outcome = self._source.write(
            self._picture,
            now_ns,
            age_ns=self._age_ns,
            news=self._fresh,
            renews=renews,
            broken={*self._refused, *self._staleness.lacking},
        )
        self._fresh = set()
        for signal in outcome.wrong:
            self._refused[signal] = self._picture.pop(signal)

    def _watch_repeats(self, now_ns: int) -> None:
        self._repeats += 1
        if self._repeats > REPEATS_TOLERATED:
            sentence = (
                f"values change while {self._counter} repeats {self.sequence.last}"
            )
            node = str(self._counter)
            self._faults.report(FaultKind.SEQUENCE_REPEATS, node, sentence, now_ns)


Batch = list[tuple[str, SampleVerdict]]


class FaultyIntake:
    """Hands batches on through the injected faults of the link, without them at once."""

    def __init__(self, intake: Intake, line: PeerLine) -> None:
        self._intake = intake
        self._lane: Lane[Batch] = Lane(line, "in")
        self._news = asyncio.Event()

    def missing(self, node: str, why: str, now_ns: int) -> None:
        """Report a node that the peer does not have."""
        self._intake.missing(node, why, now_ns)

    def receive(
        self, samples: Iterable[tuple[str, SampleVerdict]], now_ns: int
    ) -> None:
        """Take one batch; one that is not delayed is handed on at once."""
        self._lane.put(list(samples))
        for batch in self._lane.take():
            self._intake.receive(batch, now_ns)
        self._news.set()

    async def run(self) -> None:
        """Hand delayed batches on when they are due, until the session ends."""
        while True:
            await self._wait()
            for batch in self._lane.take():
                self._intake.receive(batch, time.monotonic_ns())

    async def _wait(self) -> None:
        wait_s = self._lane.next_s
        if wait_s is not None:
            await asyncio.sleep(wait_s)
            return
        await self._news.wait()
        self._news.clear()
