"""Initial poses solved for many segments at once are those of each segment alone."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from hilserver.diagnosis.regression.free_poses import FreePoses


@settings(max_examples=30)
@given(
    counts=st.lists(st.sampled_from([0, 1, 2, 4, 9]), min_size=1, max_size=40),
    silent=st.sampled_from([None, 0, 2]),
    seed=st.integers(0, 2**32),
)
def test_every_segment_is_solved_by_itself(counts, silent, seed):
    rng = np.random.default_rng(seed)
    segment = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    columns, white = (
        rng.normal(size=(len(segment), 3)),
        rng.normal(size=(len(segment), 2)),
    )
    if silent is not None:
        columns[:, silent] = 0.0
    bases = FreePoses.of(segment, len(counts)).bases(columns)
    left, step = bases.project(white), bases.step(white[:, 0])
    assert step.shape == (len(counts), 3)
    for number in range(len(counts)):
        mine = segment == number
        solved, *_ = np.linalg.lstsq(columns[mine], white[mine], rcond=1e-9)
        assert left[mine] == pytest.approx(
            white[mine] - columns[mine] @ solved, abs=1e-7
        )
        assert step[number] == pytest.approx(
            solved[:, 0], abs=1e-6 * (1 + np.abs(solved).max())
        )


def test_what_is_taken_out_of_one_column_is_taken_out_of_many():
    rng = np.random.default_rng(3)
    segment = np.tile(np.arange(3), 50)
    bases = FreePoses.of(segment, 3).bases(rng.normal(size=(150, 3)))
    white = rng.normal(size=(150, 5))
    for k, left in enumerate(bases.project(white).T):
        assert left == pytest.approx(bases.project(white[:, k]), abs=1e-14)


def test_a_pose_that_hardly_shows_does_not_step():
    """A robot that stands still shows its place twice and no heading."""
    columns = np.zeros((40, 3))
    columns[:20, 0] = columns[20:, 1] = 1.0
    columns[:, 2] = 2.0 * columns[:, 0] - columns[:, 1] * (1.0 + 1e-13)
    white = np.concatenate([np.full(20, 3.0), np.full(20, 4.0)])
    bases = FreePoses.of(np.zeros(40, np.int64), 1).bases(columns)
    solved, *_ = np.linalg.lstsq(columns, white, rcond=1e-9)
    assert bases.step(white)[0] == pytest.approx(solved, abs=1e-9)
    assert bases.project(white) == pytest.approx(np.zeros(40), abs=1e-12)
