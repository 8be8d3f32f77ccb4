"""Metrics of the links to OPC UA peers, one series for every configured peer."""

from collections.abc import Callable, Collection, Iterator
from typing import Final

from hilserver.io.link_status import PeerStatus
from hilserver.metrics import MS, US, Metric, MetricReading, Row, S, counter, durations

Peers = Collection[PeerStatus]


def _each(
    figure: Callable[[PeerStatus], float | MetricReading | None],
) -> Callable[[Peers], Iterator[Row]]:
    """Return a reader of one figure of every peer."""
    return lambda peers: (((peer.name,), figure(peer)) for peer in peers)


def _faults(peers: Peers) -> Iterator[Row]:
    for peer in peers:
        for kind, count in sorted(peer.fault_counts.items()):
            yield (peer.name, kind), counter(count)


METRICS: Final[tuple[Metric[Peers], ...]] = (
    Metric(
        "hil_peer_connected",
        "1 while a session with the peer exists and answers.",
        ("peer",),
        _each(lambda peer: float(peer.connected)),
    ),
    Metric(
        "hil_peer_reconnects_total",
        "Sessions with the peer, not counting the first.",
        ("peer",),
        _each(lambda peer: counter(peer.reconnects)),
    ),
    Metric(
        "hil_peer_round_trip_seconds",
        "Round trip of the heartbeat read of the peer's clock.",
        ("peer",),
        _each(lambda peer: durations(peer.round_trip)),
        (100 * US, 1 * S),
    ),
    Metric(
        "hil_peer_one_way_latency_seconds",
        "Time from SourceTimestamp to arrival, corrected by the clock offset; only stamps that"
        " advance.",
        ("peer",),
        _each(lambda peer: durations(peer.one_way)),
        (100 * US, 1 * S),
    ),
    Metric(
        "hil_peer_interval_seconds",
        "Time between arrivals of data from the peer.",
        ("peer",),
        _each(lambda peer: durations(peer.interval)),
        (1 * MS, 10 * S),
    ),
    Metric(
        "hil_peer_faults_total",
        "Invalid data and refusals of a peer by kind, such as NaN with status Good or frozen"
        " stamps.",
        ("peer", "kind"),
        _faults,
    ),
    Metric(
        "hil_clock_offset_seconds",
        "Peer's clock minus ours.",
        ("peer",),
        _each(lambda peer: peer.clock_offset_s),
    ),
)
