"""Every metric of the specification moves with its source, means one thing, and fits the budget."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from prometheus_client.openmetrics.parser import (
    text_string_to_metric_families as openmetrics_families,
)
from prometheus_client.parser import text_string_to_metric_families

from hilserver.compiled.histogram import BOUNDS_NS, N_BUCKETS
from hilserver.daemon.metrics import METRICS
from hilserver.io.link_status import PeerStatus
from hilserver.io.ros2.status import CommandState
from hilserver.io.shield.words import LATE_COUNTS, LATE_SUM
from hilserver.metrics import MetricKind
from hilserver.monitoring.metrics import Metrics
from hilserver.scheduler.statistics import LatencyWindow
from hilserver.signals import State
from tests.helpers.prom_diff import PromDiff, series_of_text
from tests.monitoring.figures import FakeDaemon, slice_figures, zeros

LABELS_OF_SPECIFICATION = {
    "hil_wake_latency_seconds": {"slice"},
    "hil_execution_seconds": {"slice"},
    "hil_wake_jitter_seconds": {"slice"},
    "hil_margin_min_seconds": {"slice"},
    "hil_overruns_total": {"slice", "cause"},
    "hil_missed_ticks_total": {"slice"},
    "hil_realtime_factor": set(),
    "hil_state": {"state"},
    "hil_peer_connected": {"peer"},
    "hil_peer_reconnects_total": {"peer"},
    "hil_peer_round_trip_seconds": {"peer"},
    "hil_peer_one_way_latency_seconds": {"peer"},
    "hil_peer_interval_seconds": {"peer"},
    "hil_input_age_seconds": {"source"},
    "hil_parameters_changed": set(),
    "hil_rejected_values_total": {"source", "reason"},
    "hil_end_to_end_seconds": set(),
    "hil_clock_offset_seconds": {"peer"},
    "hil_gc_pause_seconds": set(),
    "hil_model_gap": {"channel"},
}


@pytest.fixture
def daemon() -> FakeDaemon:
    return FakeDaemon()


@pytest.fixture
def metrics(daemon: FakeDaemon) -> Metrics:
    return Metrics(*daemon.sources())


def counts_of(*latencies_ns: int) -> np.ndarray:
    counts = zeros()
    np.add.at(counts, np.searchsorted(BOUNDS_NS, latencies_ns), 1)
    return counts


def test_names_and_labels_are_those_of_the_specification() -> None:
    table = {metric.name: set(metric.labels) for metric in METRICS}
    assert {
        name: table.get(name) for name in LABELS_OF_SPECIFICATION
    } == LABELS_OF_SPECIFICATION
    assert "hil_build_info" in table


def figures(daemon: FakeDaemon, **changed: object) -> None:
    daemon.slices["plant"] = replace(daemon.slices["plant"], **changed)


def late_response(daemon: FakeDaemon, late_ns: int) -> None:
    words = daemon.shields[0].words
    words[LATE_COUNTS : LATE_COUNTS + N_BUCKETS] += counts_of(late_ns)
    words[LATE_SUM] += late_ns


EDGE = {"name": "edge", "lasting": True, "why_down": ""}
STIMULI = {
    "hil_wake_latency_seconds_bucket": lambda d: figures(
        d, latency_counts=counts_of(30_000)
    ),
    "hil_execution_seconds_bucket": lambda d: figures(
        d, execution_counts=counts_of(2_000)
    ),
    "hil_wake_jitter_seconds": lambda d: figures(
        d, window=LatencyWindow(9, 1.0, 5e3, 1.0, 1.0)
    ),
    "hil_margin_min_seconds": lambda d: figures(d, margin_min_ns=-7_000),
    "hil_overruns_total": lambda d: figures(d, late_wakes=1),
    "hil_missed_ticks_total": lambda d: figures(d, missed_ticks=4),
    "hil_realtime_factor": lambda d: setattr(d, "realtime_factor", 0.5),
    "hil_state": lambda d: setattr(d, "state", State.RUNNING),
    "hil_peer_connected": lambda d: setattr(d.peers[0], "connected", True),
    "hil_peer_reconnects_total": lambda d: setattr(d.peers[0], "reconnects", 2),
    "hil_peer_round_trip_seconds_bucket": lambda d: d.peers[0].round_trip.observe(
        700_000
    ),
    "hil_peer_one_way_latency_seconds_bucket": lambda d: d.peers[0].one_way.observe(
        700_000
    ),
    "hil_peer_interval_seconds_bucket": lambda d: d.peers[0].interval.observe(
        20_000_000
    ),
    "hil_peer_faults_total": lambda d: d.peers[0].fault_counts.update(
        ["nan_with_good"]
    ),
    "hil_shield_requests_total": lambda d: d.shields[0].requests.update(["set_rpm"]),
    "hil_shield_lateness_seconds_bucket": lambda d: late_response(d, 30_000),
    "hil_ros2_participants": lambda d: setattr(d.domains[0], "participants", 2),
    "hil_ros2_endpoints_apart": lambda d: setattr(d.domains[0], "apart", 1),
    "hil_ros2_command_held": lambda d: setattr(
        d.domains[0], "command", CommandState.HELD
    ),
    "hil_ros2_command_age_seconds": lambda d: setattr(d.domains[0], "command_ns", 0),
    "hil_input_age_seconds": lambda d: d.input_ages_s.update(opcua=0.3),
    "hil_parameters_changed": lambda d: setattr(d, "differing", 3),
    "hil_rejected_values_total": lambda d: d.rejected.update([("opcua", "not_finite")]),
    "hil_end_to_end_seconds_bucket": lambda d: d.end_to_end.observe(40_000_000),
    "hil_clock_offset_seconds": lambda d: setattr(d.peers[0], "clock_offset_s", -0.25),
    "hil_gc_pause_seconds_bucket": lambda d: d.gc_pause.observe(3_000_000),
    "hil_model_gap": lambda d: d.model_gap.update({"pose.x_m": 0.1}),
    "hil_model_gap_alarm": lambda d: d.gap_alarms.update({"pose.x_m": True}),
    "hil_output": lambda d: d.outputs.update({"pose.x_m": 1.0}),
    "hil_faults": lambda d: d.faults.update(injected=2),
    "hil_observer_samples_total": lambda d: setattr(d.observed[0], "rejected", 3),
    "hil_observer_readmitted_total": lambda d: setattr(d.observed[0], "readmitted", 1),
    "hil_recalibration_looks_total": lambda d: d.recalibration.looks.update(named=1),
    "hil_recalibration_decisions_total": lambda d: d.recalibration.decisions.update(
        accepted=1
    ),
    "hil_recalibration_failures_total": lambda d: setattr(
        d.recalibration, "failures", 1
    ),
    "hil_recalibration_proposal_open": lambda d: setattr(
        d.recalibration, "waits", True
    ),
    "hil_recalibration_gap_changed": lambda d: setattr(
        d.recalibration, "changed", True
    ),
    "hil_recalibration_looking": lambda d: setattr(d.recalibration, "is_looking", True),
    "hil_recalibration_effect_ratio": lambda d: d.recalibration.effect.update(
        {"pose.x_m": 3.0}
    ),
    "hil_asyncio_tasks": lambda d: setattr(d, "tasks", 9),
    "hil_task_up": lambda d: setattr(d.kept, "jobs", [SimpleNamespace(**EDGE)]),
    "hil_task_restarts_total": lambda d: d.kept.restarts.update(edge=1),
    "hil_task_failures_total": lambda d: d.kept.failures.update(["opcua request"]),
    "hil_audit_ok": lambda d: d.audit.update(rtprio=True),
}


@pytest.mark.parametrize("name", STIMULI)
def test_a_metric_moves_with_its_source_and_no_other_does(
    name: str, daemon: FakeDaemon, metrics: Metrics
) -> None:
    def scrape() -> str:
        return metrics.render()[0].decode()

    with PromDiff(scrape) as diff:
        STIMULI[name](daemon)
    family = name.removesuffix("_bucket")
    moved = {series for series in diff.moved() if series.startswith("hil_")}
    assert moved - {f"{family}_sum", f"{family}_count"} == {name}


def test_every_row_of_the_table_has_a_stimulus() -> None:
    stimulated = {name.removesuffix("_bucket") for name in STIMULI} | {"hil_build_info"}
    assert stimulated == {metric.name for metric in METRICS}


def test_overruns_are_told_apart_by_cause(daemon: FakeDaemon, metrics: Metrics) -> None:
    with PromDiff(metrics.registry) as diff:
        figures(daemon, late_wakes=3, long_runs=1)
    assert diff["hil_overruns_total", {"slice": "plant", "cause": "late_wake"}] == 3
    assert diff["hil_overruns_total", {"slice": "plant", "cause": "long_run"}] == 1
    assert diff["hil_overruns_total", {"slice": "own", "cause": "long_run"}] == 0


def test_exactly_one_state_is_set(daemon: FakeDaemon, metrics: Metrics) -> None:
    daemon.state = State.PAUSED
    series = series_of_text(metrics.render()[0].decode())
    states = {
        dict(labels)["state"]: v
        for (name, labels), v in series.items()
        if name == "hil_state"
    }
    assert states == {
        "starting": 0,
        "running": 0,
        "paused": 1,
        "safe": 0,
        "stopping": 0,
    }


def test_histogram_cumulates_and_keeps_what_lies_outside_its_range(
    daemon: FakeDaemon, metrics: Metrics
) -> None:
    latencies = [500, 5_000, 5_001, 10_000, 90_000_000, 100_000_001, 60 * 10**9]
    figures(daemon, latency_counts=counts_of(*latencies), latency_sum_ns=sum(latencies))
    series = series_of_text(metrics.render()[0].decode())
    name, plant = "hil_wake_latency_seconds", ("slice", "plant")
    bucket = {
        le: series[f"{name}_bucket", frozenset({plant, ("le", le)})] for le in LE_WAKE
    }
    # the bound belongs to its bucket; below the range as well
    assert bucket["5e-06"] == 2
    assert bucket["1e-05"] == 4
    assert bucket["0.05"] == 4
    assert bucket["0.1"] == 5
    assert bucket["+Inf"] == 7
    assert series[f"{name}_count", frozenset({plant})] == 7
    assert series[f"{name}_sum", frozenset({plant})] == pytest.approx(
        sum(latencies) / 1e9
    )


LE_WAKE = ["5e-06", "1e-05", "0.05", "0.1", "+Inf"]


@pytest.mark.parametrize(
    "metric", [m for m in METRICS if m.kind is MetricKind.HISTOGRAM]
)
def test_exported_bounds_are_1_2_5_bounds(metric) -> None:
    indices = metric.bound_indices
    assert (BOUNDS_NS[indices[0]], BOUNDS_NS[indices[-1]]) == metric.range_ns
    assert indices[-1] < N_BUCKETS - 1


def test_unknown_figures_are_left_out_instead_of_invented(metrics: Metrics) -> None:
    names = {name for name, _ in series_of_text(metrics.render()[0].decode())}
    assert names.isdisjoint(
        {
            "hil_wake_jitter_seconds",
            "hil_margin_min_seconds",
            "hil_clock_offset_seconds",
        }
        | {"hil_input_age_seconds", "hil_model_gap", "hil_model_gap_alarm"}
    )


def test_default_configuration_stays_within_300_series() -> None:
    daemon = FakeDaemon()
    daemon.fill()
    metrics = Metrics(*daemon.sources())
    for is_openmetrics in (False, True):
        text = metrics.render(is_openmetrics)[0].decode()
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        assert len(lines) <= 300
        # the library's own are counted
        assert any(line.startswith("process_") for line in lines)


def test_openmetrics_and_text_agree_and_parse(
    daemon: FakeDaemon, metrics: Metrics
) -> None:
    daemon.fill()
    daemon.gc_pause.observe(10**6)
    text, text_type = metrics.render()
    openmetrics, openmetrics_type = metrics.render(True)
    assert text_type.startswith("text/plain; version=0.0.4")
    assert openmetrics_type.startswith("application/openmetrics-text; version=1.0.0")
    values = [
        {
            (sample.name, *sorted(sample.labels.items())): sample.value
            for family in families
            for sample in family.samples
            if sample.name.startswith("hil_")
        }
        for families in (
            text_string_to_metric_families(text.decode()),
            openmetrics_families(openmetrics.decode()),
        )
    ]
    assert values[0] == values[1]
    assert len(values[0]) > 200


def test_hostile_label_values_stay_inside_their_quotes() -> None:
    daemon = FakeDaemon()
    daemon.peers = [PeerStatus('a"b\\c\nhil_state{state="running"} 1')]
    series = series_of_text(Metrics(*daemon.sources()).render()[0].decode())
    label = frozenset({("peer", daemon.peers[0].name)})
    assert series["hil_peer_connected", label] == 0


def test_a_reset_of_the_statistics_moves_no_total_back(
    daemon: FakeDaemon, metrics: Metrics
) -> None:
    plant = {"slice": "plant"}
    late = {**plant, "cause": "late_wake"}
    with PromDiff(metrics.registry) as diff:
        figures(
            daemon,
            late_wakes=5,
            latency_counts=counts_of(1, 1),
            latency_sum_ns=2 * 10**9,
        )
        daemon.end_to_end.observe(10**9)
        with metrics.statistics_reset():
            daemon.slices["plant"] = slice_figures("plant")
            daemon.end_to_end.clear()
        figures(
            daemon,
            late_wakes=7,
            latency_counts=counts_of(1, 1, 1),
            latency_sum_ns=10**9,
        )
    assert diff["hil_overruns_total", late] == 12
    assert diff["hil_wake_latency_seconds_count", plant] == 5
    assert diff["hil_wake_latency_seconds_sum", plant] == pytest.approx(3)
    assert diff["hil_end_to_end_seconds_count"] == 1


def test_a_reset_by_another_process_is_noticed_when_a_count_falls(
    daemon: FakeDaemon, metrics: Metrics
) -> None:
    late = {"slice": "plant", "cause": "late_wake"}
    with PromDiff(metrics.registry) as diff:
        figures(daemon, late_wakes=5)
        metrics.render()
        figures(daemon, late_wakes=2)
    assert diff["hil_overruns_total", late] == 7


def test_slices_are_read_once_per_scrape() -> None:
    daemon = FakeDaemon()
    Metrics(*daemon.sources()).render()
    assert daemon.n_reads == 1


@pytest.mark.parametrize("factor", [math.nan, math.inf])
def test_a_realtime_factor_that_is_no_number_is_left_out(
    factor: float, daemon: FakeDaemon, metrics: Metrics
) -> None:
    daemon.realtime_factor = factor
    text = metrics.render()[0].decode()
    assert "hil_realtime_factor" not in {name for name, _ in series_of_text(text)}
