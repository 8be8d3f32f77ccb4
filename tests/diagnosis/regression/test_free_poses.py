"""Initial poses solved for many segments at once are those of each segment alone."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from hilserver.diagnosis.regression.free_poses import AT_ONCE, FreePoses


@settings(max_examples=30)
@given(
    counts=st.lists(st.sampled_from([0, 1, 2, 4, 9]), min_size=1, max_size=2 * AT_ONCE),
    silent=st.sampled_from([None, 0, 2]),
    seed=st.integers(0, 2**32),
)
def test_every_segment_is_solved_by_itself(counts, silent, seed):
    rng = np.random.default_rng(seed)
    segment = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    columns, white = rng.normal(size=(len(segment), 3)), rng.normal(size=(len(segment), 2))
    if silent is not None:
        columns[:, silent] = 0.0
    poses = FreePoses(segment, len(counts))
    left = poses.project(white, poses.bases(columns))
    step = poses.step(columns, white[:, 0])
    assert step.shape == (len(counts), 3)
    for number in range(len(counts)):
        mine = segment == number
        solved, *_ = np.linalg.lstsq(columns[mine], white[mine], rcond=1e-9)
        assert left[mine] == pytest.approx(white[mine] - columns[mine] @ solved, abs=1e-7)
        assert step[number] == pytest.approx(solved[:, 0], abs=1e-6 * (1 + np.abs(solved).max()))
