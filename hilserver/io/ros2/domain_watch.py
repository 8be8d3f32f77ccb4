"""What others in the domain have that fits ours, and what does not: looked at now and then."""

import time
from collections.abc import Collection, Sequence
from typing import Final

import structlog

from hilserver.io.link_status import FaultBook, LinkState
from hilserver.io.ros2.neighbours import Neighbours, other_domains, topics_of
from hilserver.io.ros2.participant import In, Out
from hilserver.io.ros2.status import Ros2Fault, Ros2Status

ALONE_AFTER: Final = 20
"""Looks without any other participant, until the log says where other programs are."""

_log = structlog.get_logger(__name__)

Endpoints = Sequence[tuple[str, In | Out]]


class DomainWatch:
    """Keeps the status of the node and its faults in step with discovery."""

    def __init__(
        self, status: Ros2Status, faults: FaultBook, neighbours: Neighbours, domain: int
    ) -> None:
        self._status, self._faults = status, faults
        self._neighbours, self._domain = neighbours, domain
        self._alone = 0
        self._elsewhere: list[int] = []  # domains that the log has named
        self._seen: dict[str, int] = {}

    def look(self, topics: Endpoints, services: Sequence[In | Out]) -> None:
        """Judge our endpoints: those of topics by name, and those of services."""
        ours = [endpoint for _, endpoint in topics]
        apart = list(self._neighbours.apart([*ours, *services]))
        for kind, topic, sentence in apart:
            self._faults.report(kind, topic, sentence, time.monotonic_ns())
        self._status.apart = len(apart)

        unfit = dict(self._neighbours.incompatible(ours))
        for subject, sentence in unfit.items():
            self._report(Ros2Fault.INCOMPATIBLE_QOS, subject, sentence)

        known = {topic for _, topic, _ in apart}
        known |= {f"rt{subject.partition(' ')[0]}" for subject in unfit}
        self._look_at_endpoints(topics, known)
        self._look_at_neighbours(ours, services)

    def _look_at_endpoints(self, topics: Endpoints, known: Collection[str]) -> None:
        """Count matched endpoints, losses, and those that will never match.

        Of topics that are `known`, somebody has said why not.
        """
        status, matched = self._status, 0
        for name, endpoint in topics:
            matched += endpoint.matched
            key = f"{name} {endpoint.subject.type}"
            grows = self._grows(f"qos {key}", endpoint.incompatible)
            if grows and endpoint.subject.topic not in known:
                sentence = (
                    f"a node's quality of service for {name} is incompatible, so no data flows:"
                    f" compare deadline and liveliness by 'ros2 topic info --verbose {name}'"
                )
                self._report(Ros2Fault.INCOMPATIBLE_QOS, name, sentence)
            if isinstance(endpoint, In) and (
                more := self._grows(f"lost {key}", endpoint.lost)
            ):
                status.sequence_missed += more
                self._report(
                    Ros2Fault.SAMPLE_LOST, name, f"messages of {name} were lost"
                )
        if bool(matched) != status.connected:
            status.connected = bool(matched)
            status.state = LinkState.CONNECTED if matched else LinkState.CONNECTING
            if matched:
                status.reconnects += status.last_connect_ns is not None
                status.last_connect_ns = time.monotonic_ns()
            _log.info("ROS 2 endpoints", matched=matched)

    def _look_at_neighbours(
        self, topics: Sequence[In | Out], services: Sequence[In | Out]
    ) -> None:
        """Tell what of other participants does not fit, and where others are if nobody is here."""
        neighbours, status = self._neighbours, self._status
        written = [endpoint for endpoint in topics if isinstance(endpoint, Out)]
        for whose, sentence in neighbours.clashes(written):
            self._report(Ros2Fault.ALSO_PUBLISHED, whose, sentence)

        strangers = list(neighbours.strangers([*topics, *services]))
        for stranger in strangers:
            if not stranger.is_reported:
                stranger.is_reported = True
                _log.warning(
                    "ROS 2: none of a participant's topics and services fits ours",
                    participant=stranger.label,
                    ours=topics_of(topics),
                )
        status.participants, status.strangers = len(neighbours.known), len(strangers)

        self._alone = 0 if neighbours.known else self._alone + 1
        if self._alone and self._alone % ALONE_AFTER == 0:
            domains = other_domains(self._domain)
            if domains and domains != self._elsewhere:
                _log.warning(
                    "ROS 2: nobody is in this domain, and programs of this computer are in others:"
                    " set ros2.domain or ROS_DOMAIN_ID",
                    domain=self._domain,
                    others=domains,
                )
            self._elsewhere = domains

    def _grows(self, key: str, total: int) -> int:
        before = self._seen.get(key, 0)
        self._seen[key] = total
        return total - before

    def _report(self, kind: Ros2Fault, subject: str, sentence: str) -> None:
        self._faults.report(kind, subject, sentence, time.monotonic_ns())
