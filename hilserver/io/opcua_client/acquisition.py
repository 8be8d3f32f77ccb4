"""How values come in: subscribed, polled, or subscribed first and polled if that is too slow.

``auto`` leaves the subscription if the peer samples or publishes slower than requested, or if
more than a twentieth of the sequence numbers do not arrive within two seconds. It then polls until
the next connection.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import structlog
from asyncua import ua

from hilserver.config.peers import PeerConfig
from hilserver.io.link_status import PeerStatus
from hilserver.io.opcua_client.session import PeerSession, judge, read_request
from hilserver.io.opcua_client.subscription import Grant, PeerSubscription
from hilserver.io.peer_link.intake import FaultyIntake
from hilserver.period import every

OBSERVED_S = 2.0
MISSED_SHARE_MAX = 0.05
SLOWER_THAN_ASKED = 1.5
LOOK_AGAIN_S = 1.0

_log = structlog.get_logger(__name__)


def too_slow(grant: Grant, *, publishing_ms: float, poll_ms: float) -> str:
    """Return a sentence if the granted intervals are too slow, else an empty text.

    `publishing_ms` and `poll_ms`: the requested publishing interval and the period of polling.
    """
    limit_ms = max(publishing_ms, poll_ms)
    if grant.sampling_ms > max(limit_ms, grant.publishing_ms):
        return f"the peer samples every {grant.sampling_ms:g} ms"
    if grant.publishing_ms > SLOWER_THAN_ASKED * limit_ms:
        return f"the peer publishes every {grant.publishing_ms:g} ms instead of {publishing_ms:g}"
    return ""


def too_many_missed(received: int, missed: int) -> str:
    """Return a sentence if the observed rate is too slow, else an empty text."""
    if missed <= MISSED_SHARE_MAX * (received + missed):
        return ""
    return f"{missed} of {received + missed} sequence numbers did not arrive"


@dataclass(frozen=True)
class Acquisition:
    """Brings the samples of one session to the intake."""

    session: PeerSession
    config: PeerConfig
    status: PeerStatus
    intake: FaultyIntake
    # called with a sentence if the peer grants less than requested
    report_slow: Callable[[str], None]

    @property
    def nodes(self) -> list[str]:
        """Every node that is read."""
        extra = [self.config.sequence_node] if self.config.sequence_node else []
        return list(dict.fromkeys([*self.config.read, *extra]))

    async def run(self) -> None:
        """Bring samples until the session ends."""
        reason = "as configured"
        if self.config.mode != "poll":
            reason = await self._subscribe()
            self.report_slow(
                f"{reason}: polling every {self.config.poll_ms:g} ms instead"
            )
        await self._poll(reason)

    async def _subscribe(self) -> str:
        """Stay subscribed; return, in mode auto, why polling is better."""
        config = self.config
        intake = self.intake
        subscription = PeerSubscription(
            self.session,
            intake,
            poll_ms=config.poll_ms,
            every_stamp=config.sequence_node is None,
        )
        grant = await subscription.create(
            publishing_ms=config.publishing_ms,
            sampling_ms=config.sampling_ms,
            keep_alive_ms=config.stale_after_ms / 3,
        )
        missing = await subscription.add(self.nodes)
        grant = subscription.grant
        self._enter(
            "subscribe",
            "as configured" if config.mode == "subscribe" else "fast enough",
        )
        while True:
            self.status.granted_publishing_ms = grant.publishing_ms
            self.status.granted_sampling_ms = grant.sampling_ms
            slow = too_slow(
                grant, publishing_ms=config.publishing_ms, poll_ms=config.poll_ms
            )
            if slow and config.mode == "auto":
                await subscription.delete()
                return slow
            if slow:
                self.report_slow(f"{slow}, and mode is subscribe")
            slow = await self._observe(
                subscription, OBSERVED_S if not missing else LOOK_AGAIN_S
            )
            if slow:
                await subscription.delete()
                return slow
            if missing:
                missing = await subscription.add(missing)
                grant = subscription.grant

    async def _observe(self, subscription: PeerSubscription, duration_s: float) -> str:
        """Watch the running subscription for a while; return why it is too slow, if it is."""
        received = self.status.sequence_received
        missed = self.status.sequence_missed
        await subscription.watch(duration_s)
        slow = too_many_missed(
            self.status.sequence_received - received,
            self.status.sequence_missed - missed,
        )
        if slow and self.config.mode == "subscribe":
            self.report_slow(f"{slow}, and mode is subscribe")
            return ""
        return slow

    def _enter(self, mode: str, reason: str) -> None:
        self.status.mode = mode
        self.status.mode_reason = reason
        _log.info("peer mode", peer=self.config.name, mode=mode, reason=reason)

    async def _poll(self, reason: str) -> None:
        self._enter("poll", reason)
        names: list[str] = []
        request = ua.ReadParameters()
        look_again_at = 0.0

        async def cycle() -> None:
            nonlocal names, request, look_again_at
            if time.monotonic() >= look_again_at:
                names, nodes = await self._resolved()
                request = read_request(nodes, ua.AttributeIds.Value)
                complete = len(names) == len(self.nodes)
                if complete:
                    look_again_at = float("inf")
                else:
                    look_again_at = time.monotonic() + LOOK_AGAIN_S
            if names:
                values = await self.session.read(request)
                now_ns = time.monotonic_ns()
                judged = map(judge, values)
                self.intake.receive(zip(names, judged, strict=True), now_ns)

        await every(self.config.poll_ms / 1000, cycle, self._skipped)

    def _skipped(self, count: int) -> None:
        self.status.polls_skipped += count

    async def _resolved(self) -> tuple[list[str], list[ua.NodeId]]:
        found = await self.session.resolve(self.nodes)
        now_ns = time.monotonic_ns()
        for name, node in found.items():
            if node is None:
                self.intake.missing(
                    name, "the peer does not have this namespace", now_ns
                )
        known = {name: node for name, node in found.items() if node is not None}
        return list(known), list(known.values())
