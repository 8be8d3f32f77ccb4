"""Thinned frames say the same as all of them: every change at its tick, and the value before it."""

import hypothesis
import numpy as np
from hypothesis import strategies as st

from hilserver.image import FrameBatch
from hilserver.io.recorder.thinning import LEAST_EVERY, Thinner
from hilserver.logs.writer import Segmented

N_SLOTS = 4
RECORDED = [0, 2]


def frames(rng, n):
    """Give frames in which a signal changes now and then, one of them NaN before its first."""
    changes = rng.random((n, N_SLOTS)) < 0.03
    values = np.cumsum(changes, axis=0).astype(float)
    values[values == 0.0] = np.nan
    words = np.zeros((n, 3 + N_SLOTS), dtype=np.int64)
    words[:, 0] = np.arange(n) + 7
    words[:, 3] = np.cumsum(rng.random(n) < 0.01)
    return FrameBatch(0, words, values)


def thinned(whole, cuts):
    thinner, kept = Thinner(RECORDED), []
    for begin, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        if begin == end:
            continue
        part = FrameBatch(begin, whole.words[begin:end], whole.values[begin:end])
        kept.append(
            thinner.thinned(
                Segmented(part, np.zeros(end - begin, dtype=np.int64))
            ).frames
        )
    ticks = np.concatenate([batch.ticks for batch in kept])
    return ticks, np.concatenate([batch.values for batch in kept])


@hypothesis.given(
    seed=st.integers(0, 999), cuts=st.lists(st.integers(0, 400), max_size=4)
)
def test_every_tick_follows_from_what_is_kept(seed, cuts):
    whole = frames(np.random.default_rng(seed), 400)
    ticks, values = thinned(whole, sorted(cuts))
    assert (np.diff(ticks) > 0).all()
    n = int(ticks[-1]) - 7 + 1
    last = np.searchsorted(ticks, np.arange(n) + 7, side="right") - 1
    seen = values[last][:, RECORDED]
    np.testing.assert_array_equal(seen, whole.values[:n, RECORDED])


@hypothesis.given(seed=st.integers(0, 99))
def test_the_frame_before_a_change_is_there_and_silence_shows(seed):
    whole = frames(np.random.default_rng(seed), 400)
    ticks, _ = thinned(whole, [])
    content = np.concatenate(
        [whole.values[:, RECORDED].view(np.int64), whole.status[:, RECORDED]], axis=1
    )
    changed = whole.ticks[1:][(content[1:] != content[:-1]).any(axis=1)]
    changed = changed[changed < ticks[-1]]
    assert {*changed.tolist(), *(changed - 1).tolist()} <= {*ticks.tolist()}
    assert np.diff(ticks).max() <= LEAST_EVERY


def test_it_leaves_most_out():
    whole = frames(np.random.default_rng(1), 4000)
    assert len(thinned(whole, [])[0]) < 1000
