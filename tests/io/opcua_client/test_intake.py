"""What the gate gets from any stream of samples."""

import math

from asyncua import ua
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.core.events import EventBus
from hilserver.io.link_status import HOLD_NS, PeerStatus
from hilserver.io.opcua_client.session import judge
from hilserver.io.peer_link.intake import Intake
from hilserver.io.peer_link.samples import FaultKind, SampleVerdict
from hilserver.io.source import Source
from tests.io.opcua_client.conftest import URI, RecordingGate, peer_config

FL, RR, SEQ = (f"nsu={URI};s={name}" for name in ("rpm_set_FL", "rpm_set_RR", "seq"))


class Bench:
    def __init__(self, **changes):
        config = peer_config(1, **changes)
        self.status = PeerStatus("iot2050")
        self.gate, self.events = RecordingGate(), EventBus()
        commanding = [n for n in config.inputs if n.partition(".")[0] != "measured"]
        source = Source(
            config.driver,
            "peer iot2050",
            self.status,
            self.gate,
            self.events.publish,
            fresh=lambda: "fresh",
            commanding=commanding,
        )
        self.faults, self.staleness = source.faults, source.staleness
        self.intake = Intake(config, source, lambda ns: ns)
        self.now_ns = 0

    def receive(self, *samples):
        self.now_ns += 10_000_000
        self.intake.receive(
            [(n, judge(ua.DataValue(v))) for n, v in samples], self.now_ns
        )
        self.staleness.check(self.now_ns)


VALUES = st.one_of(
    st.floats(), st.text(max_size=3), st.none(), st.booleans(), st.binary(max_size=3)
)
BATCH = st.lists(st.tuples(st.sampled_from([FL, RR]), VALUES), max_size=4)


@settings(max_examples=150, deadline=None)
@given(st.lists(BATCH, max_size=20))
def test_only_finite_numbers_reach_the_gate_and_the_latest_wins(batches):
    bench = Bench()
    bench.receive((FL, 0.0), (RR, 0.0), (SEQ, 0))
    newest = {FL: 0.0, RR: 0.0}
    for number, batch in enumerate(batches, 1):
        bench.receive(*batch, (SEQ, number))
        newest |= dict(batch)
        group = bench.gate.groups[-1]
        assert group["input.sequence"] == number
        for node, signal in (
            (FL, "wheel.fl.setpoint_rpm"),
            (RR, "wheel.rr.setpoint_rpm"),
        ):
            value = newest.get(node)
            usable = isinstance(value, int | float) and math.isfinite(value)
            assert (group[signal] == value) if usable else (signal not in group)
    assert bench.gate.all_finite


def test_nothing_is_driven_before_every_commanding_input_had_a_value():
    bench = Bench()
    bench.intake.expect([FL, RR], 0)
    bench.receive((FL, 1.0), (SEQ, 1))
    assert bench.gate.groups == []
    bench.receive((RR, -1.0), (SEQ, 2))
    assert bench.gate.latest["wheel.fl.setpoint_rpm"] == 1.0
    assert bench.gate.latest["wheel.rr.setpoint_rpm"] == -1.0


def test_one_node_feeds_several_inputs():
    left = ["wheel.fl.setpoint_rpm", "wheel.rl.setpoint_rpm"]
    bench = Bench(read={FL: left, RR: "wheel.rr.setpoint_rpm"})
    bench.receive((FL, 7.0), (RR, -7.0), (SEQ, 1))
    assert [bench.gate.latest[name] for name in left] == [7.0, 7.0]
    bench.receive((FL, math.nan), (SEQ, 2))
    assert not set(left) & set(bench.gate.groups[-1])


def test_a_batch_without_a_newer_number_brings_nothing_in():
    bench = Bench()
    bench.receive((FL, 1.0), (SEQ, 1))
    bench.receive((FL, 2.0), (SEQ, 1))
    assert bench.gate.values("wheel.fl.setpoint_rpm") == [1.0]
    bench.receive((SEQ, 2))
    assert bench.gate.values("wheel.fl.setpoint_rpm") == [1.0, 2.0]


def test_without_a_counter_a_keep_alive_attests_what_is_known():
    bench = Bench(sequence_node=None)
    bench.receive((FL, 1.0))
    bench.receive()
    assert bench.gate.values("wheel.fl.setpoint_rpm") == [1.0, 1.0]
    assert bench.status.input_age_s(bench.now_ns) == 0.0


def test_a_new_session_remembers_no_value_of_the_old_one():
    bench = Bench()
    bench.receive((FL, 1.0), (SEQ, 1))
    bench.intake.begin_session()
    bench.receive((SEQ, 2))
    assert "wheel.fl.setpoint_rpm" not in bench.gate.groups[-1]


def test_a_fault_is_told_once_and_ends_when_it_was_not_seen_for_long():
    bench = Bench()
    for number in range(20):
        bench.receive((FL, math.nan if number % 2 else 1.0), (SEQ, number))
    assert bench.status.fault_counts[FaultKind.NOT_FINITE] == 10
    assert len(bench.events.recent) == 1
    bench.faults.expire(bench.now_ns + HOLD_NS - 10_000_000)
    assert bench.status.faults
    bench.faults.expire(bench.now_ns + HOLD_NS + 1)
    assert not bench.status.faults


def test_what_the_peer_has_not_sampled_anew_is_no_sample():
    """Every group is the whole picture, but the tag has a clock of its own."""
    read = {FL: "measured.wheel.fl.speed_rpm", RR: "measured.nav.x_m"}
    bench = Bench(read=read)
    bench.receive((FL, 1.0), (RR, 5.0), (SEQ, 1))
    bench.receive((FL, 2.0), (SEQ, 2))
    bench.receive((FL, 3.0))  # its number follows
    bench.receive((SEQ, 3))
    assert [group["measured.nav.x_m"] for group in bench.gate.groups] == [5.0] * 3
    assert [sorted(news) for news in bench.gate.news] == [sorted(read.values())] + [
        [read[FL]]
    ] * 2


def test_how_old_samples_are_follows_from_the_stamp_of_the_number():
    bench = Bench()
    bench.intake.offset.read(0, 100, 1_000_050)
    bench.intake.offset.read(100, 200, 1_000_150)
    stamps = (0, 10_000_000, 15_000_000, 20_000_000)
    for k, stamp_ns in enumerate((*stamps, -5_000_000_000, 500_000_000)):
        bench.now_ns += 10_000_000
        verdict = SampleVerdict(value=k, stamp_ns=1_000_000 + stamp_ns)
        bench.intake.receive(
            [(FL, SampleVerdict(value=float(k))), (SEQ, verdict)], bench.now_ns
        )
    # the first proves nothing, then 10, 15 and 20 ms; one is older, the last one from the future
    assert bench.gate.ages_ns == [0, 10_000_000, 15_000_000, 20_000_000, 0, 0]


def test_a_controller_that_hangs_says_nothing_new_in_another_session():
    """Before, each reconnection let the robot drive by the old set-points until they were stale."""
    bench = Bench()
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 7))
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 8))
    bench.intake.begin_session()
    handed_over = len(bench.gate.groups)
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 8))
    assert len(bench.gate.groups) == handed_over
    bench.intake.begin_session()  # and once more without a word in between
    bench.intake.begin_session()
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 8))
    assert len(bench.gate.groups) == handed_over
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 9))
    assert bench.gate.groups[-1]["input.sequence"] == 9
    bench.intake.begin_session()  # it has started again
    bench.receive((FL, 20.0), (RR, 20.0), (SEQ, 0))
    assert bench.gate.groups[-1]["input.sequence"] == 0
