"""Segments, blocks and folds: no sample is lost or counted twice, and no block has two halves."""

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from hilserver.diagnosis.replay.stack import make_stack
from hilserver.measured.clock import cut
from hilserver.measured.thresholds import SHORTEST_SEGMENT_S
from tests.diagnosis.toy import PERIOD_S, SIGNAL, measured_log

SPANS = st.lists(st.integers(2, 2500), min_size=1, max_size=8)


def log_of(lengths, blocks=None):
    edges = np.concatenate([[0], np.cumsum(lengths)])
    return measured_log(np.arange(edges[-1], dtype=float), edges=edges, blocks=blocks)


def stack_of(log, *, longest_s=10.0, block_s=3.0, **options):
    segments = cut(log, PERIOD_S, longest_s)
    return segments, make_stack(log, [SIGNAL], segments, block_s=block_s, **options)


@hypothesis.given(SPANS, st.one_of(st.none(), st.floats(1.0, 40.0)))
@hypothesis.settings(max_examples=60, deadline=None)
def test_segments_cover_their_spans_and_are_no_longer_than_asked(lengths, longest_s):
    log = log_of(lengths)
    segments = cut(log, PERIOD_S, longest_s)
    usable = [s for s in log.spans if s.end_s - s.start_s >= SHORTEST_SEGMENT_S]
    assert sorted(set(segments.span)) == [
        i for i, s in enumerate(log.spans) if s in usable
    ]
    for i in set(segments.span):
        mine = np.flatnonzero(segments.span == i)
        assert segments.start_s[mine[0]] == log.spans[i].start_s
        assert segments.end_s[mine[-1]] >= log.spans[i].end_s
        assert segments.end_s[mine[:-1]] == pytest.approx(segments.start_s[mine[1:]])
        length = segments.end_s[mine] - segments.start_s[mine]
        if longest_s is None:
            assert len(mine) == 1
        else:
            assert length.max() <= longest_s + PERIOD_S + 1e-9
            assert np.ptp(length) <= PERIOD_S + 1e-9, "of equal length"
    rows = np.diff(segments.first)
    assert segments.ticks == rows.sum()
    assert np.all(rows * segments.period_s >= segments.end_s - segments.start_s)


@hypothesis.given(SPANS, st.floats(1.0, 40.0), st.floats(0.5, 6.0))
@hypothesis.settings(max_examples=60, deadline=None)
def test_every_sample_is_in_one_block_of_its_segment(lengths, longest_s, block_s):
    log = log_of(lengths)
    segments = cut(log, PERIOD_S, longest_s)
    hypothesis.assume(len(segments) > 0)
    stack = make_stack(log, [SIGNAL], segments, block_s=block_s)
    kept = [n for n in lengths if (n - 1) * PERIOD_S >= SHORTEST_SEGMENT_S - 1e-9]
    assert len(stack) == sum(kept)
    assert np.all((stack.block >= 0) & (stack.block < stack.n_blocks))
    assert len(stack.fold) == stack.n_blocks
    assert set(stack.fold) <= {0, 1}
    for b in np.unique(stack.block):
        mine = stack.block == b
        assert len(set(stack.segment[mine])) == 1, "a block crosses a segment"
        assert np.ptp(stack.t_s[mine]) <= 1.5 * block_s + PERIOD_S + 1e-9
        rows = np.flatnonzero(mine)
        assert np.all(np.diff(rows) == 1), "a block is one stretch of time"
    assert stack.block_sums(np.ones(len(stack))).sum() == len(stack)
    where = stack.at - segments.first[stack.segment]
    assert where * PERIOD_S + segments.start_s[stack.segment] == pytest.approx(
        stack.t_s
    )
    assert np.all((stack.low <= stack.at + 1e-6) & (stack.at <= stack.high + 1e-6))


def test_folds_take_turns_by_segment_where_there_are_many_and_by_block_where_there_are_few():
    _, many = stack_of(log_of([3000]))  # 60 s: six segments
    by_segment = [set(many.fold[many.block[many.segment == s]]) for s in range(6)]
    assert by_segment == [{0}, {1}, {0}, {1}, {0}, {1}]
    _, few = stack_of(log_of([1500]))
    assert few.fold.tolist() == [k % 2 for k in range(few.n_blocks)]


def test_the_blocks_of_the_log_are_taken_where_it_names_them():
    _, stack = stack_of(log_of([800, 800, 800, 800], blocks=[7, 7, 3, 9]))
    assert stack.n_blocks == 3
    assert stack.fold.tolist() == [0, 1, 0]
    starts = np.searchsorted(stack.t_s, np.array([0, 800, 1600, 2400]) * PERIOD_S)
    assert stack.block[starts].tolist() == [1, 1, 0, 2]


def test_block_sums_are_sums_over_blocks():
    _, stack = stack_of(log_of([900, 400]))
    rng = np.random.default_rng(0)
    values = rng.normal(size=(len(stack), 2))
    sums = stack.block_sums(values)
    for b in range(stack.n_blocks):
        assert sums[b] == pytest.approx(values[stack.block == b].sum(axis=0))
    assert stack.block_sums(values[:, 0]) == pytest.approx(sums[:, 0])


def test_the_start_of_a_segment_and_unusable_segments_can_be_left_out():
    log = log_of([1500])
    segments, stack = stack_of(log, skip_s=1.0, usable=np.array([True, False, True]))
    assert set(stack.segment) == {0, 2}
    for s in (0, 2):
        assert stack.t_s[stack.segment == s].min() >= segments.start_s[s] + 1.0 - 1e-9


def test_runs_are_continuous_stretches():
    _, stack = stack_of(log_of([700, 300, 900]))
    runs = list(stack.runs())
    assert [name for name, _, _ in runs] == [SIGNAL] * len(runs)
    assert sum(part.stop - part.start for _, _, part in runs) == len(stack)
    for _, segment, part in runs:
        assert set(stack.segment[part]) == {segment}
        assert np.all(np.diff(stack.t_s[part]) > 0.0)
