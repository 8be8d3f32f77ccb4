"""No tearing: a reader in another process never sees half a frame."""

import mmap
import multiprocessing
import time
from typing import Any

import numpy as np
import pytest

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire
from hilserver.image import ImageReader, ProcessImage, read_frames, word
from hilserver.image import layout as lay
from hilserver.image.ring import copy_latest, publish_frame
from hilserver.image.shared_file import path_of
from hilserver.signals import Direction, Signal, SignalTable, ValueType
from tests.fakes import make_image

N_DOUBLES = 64
N_FRAMES = 1_000_000
WITHIN_S = 120
N_WHOLE, BURST = 20_000, 200


def table_of(n: int) -> SignalTable:
    return SignalTable(
        Signal(f"s{i}", "1", ValueType.DOUBLE, Direction.OUT, -1e18, 1e18, "", (i,))
        for i in range(n)
    )


@pytest.fixture
def image(request):
    image = ProcessImage(
        f"test-ring-{request.node.name[:20]}",
        table_of(N_DOUBLES),
        live={},
        fixed={},
        base_period_ns=1_000_000,
        ring_length=1,  # the hardest case: the writer comes round with every frame
        queue_rows=8,
    )
    yield image
    image.close()


@kernel()
def write_frames(first: int, n: int, values: Any, words: Any) -> None:
    """Publish frames whose values all equal the frame's number."""
    frame = words[word.FRAME_BASE]
    for number in range(first, first + n):
        for slot in range(words[word.N_SLOTS]):
            values[frame + slot] = number
        publish_frame(number, number, values, words)


@kernel()
def copy_without_lock(values: Any, words: Any, out_values: Any, out_words: Any) -> int:
    """Read the newest frame as `copy_latest` does, with the sequence lock taken out."""
    head = load_acquire(words, word.RING_HEAD)
    if head == 0:
        return -1
    base = words[word.RING_BASE]
    out_words[0] = words[base + 1]
    for slot in range(words[word.N_SLOTS]):
        out_values[slot] = values[base + lay.FRAME_HEADER_WORDS + slot]
    return int(head - 1)


def count_frames(copy: Any) -> Any:
    @kernel(cache=False)
    def loop(
        last: int, values: Any, words: Any, out_values: Any, out_words: Any
    ) -> Any:
        whole = torn = 0
        for _ in range(1_000_000_000):
            if load_acquire(words, word.RING_HEAD) >= last:
                break
            if copy(values, words, out_values, out_words) < 0:
                continue
            is_torn = out_words[0] != out_values[0]
            for slot in range(1, out_values.shape[0]):
                is_torn |= out_values[slot] != out_values[0]
            torn += is_torn
            whole += not is_torn
        return whole, torn

    return loop


def written_to(name: str) -> tuple[Any, Any]:
    with path_of(name).open("r+b") as file:
        memory = mmap.mmap(file.fileno(), 0)
    values, words = np.frombuffer(memory, np.float64), np.frombuffer(memory, np.int64)
    write_frames(0, 0, values, words)  # loaded before the race
    return values, words


def write_in_process(name: str, ready: Any, go: Any) -> None:
    values, words = written_to(name)
    ready.set()
    assert go.wait(120)
    write_frames(0, N_FRAMES, values, words)


def write_bursts_in_process(name: str, seen: Any) -> None:
    values, words = written_to(name)
    end_s = time.monotonic() + WITHIN_S
    for first in range(0, 1_000_000_000, BURST):
        if seen.is_set() or time.monotonic() > end_s:
            return
        write_frames(first, BURST, values, words)
        time.sleep(1e-5)


@pytest.mark.parametrize(
    ("copy", "locked"), [(copy_latest, True), (copy_without_lock, False)]
)
def test_million_frames_between_two_processes(image, copy, locked):
    loop = count_frames(copy)
    scratch = np.empty(N_DOUBLES), np.empty(N_DOUBLES + 3, dtype=np.int64)
    loop(0, image.values, image.words, *scratch)  # compile before the race
    write_frames(0, 0, image.values, image.words)
    spawn = multiprocessing.get_context("spawn")
    ready, go = spawn.Event(), spawn.Event()
    writer = spawn.Process(target=write_in_process, args=(image.name, ready, go))
    writer.start()
    assert ready.wait(120)
    go.set()
    whole, torn = loop(N_FRAMES, image.values, image.words, *scratch)
    writer.join(120)
    assert writer.exitcode == 0
    assert whole + torn > 0, "the reader saw nothing"
    if locked:
        assert torn == 0
    else:
        assert torn > 0, "the test would not notice a missing lock"


def test_readers_without_a_compiler_see_no_half_frame_either(image):
    """Through the arrays of NumPy, as page and recorder read: one frame, and many.

    Between two bursts the writer leaves them a moment: they get on however fast it is.
    """
    spawn = multiprocessing.get_context("spawn")
    seen = spawn.Event()
    writer = spawn.Process(target=write_bursts_in_process, args=(image.name, seen))
    writer.start()
    found, end_s = [], time.monotonic() + WITHIN_S
    while len(found) < N_WHOLE and time.monotonic() < end_s:
        frame, batch = image.latest(), read_frames(image, image.head - 1, 1)
        if frame is not None:
            found.append((frame.tick, frame.values))
        found += zip(batch.ticks.tolist(), batch.values, strict=True)
    seen.set()
    writer.join(WITHIN_S)
    assert writer.exitcode == 0
    assert len(found) >= N_WHOLE, "the readers saw too little"
    assert all((values == tick).all() for tick, values in found)


def test_a_batch_ends_where_the_ring_does():
    ring = make_image(ring_length=4)
    n = ring.n_slots
    for tick in range(6):
        ring.frame_values[:] = tick
        ring.frame_status[:] = 10 * tick
        publish_frame(tick, 100 + tick, ring.values, ring.words)
    assert len(read_frames(ring, 1, 9)) == 0  # overwritten
    batch = read_frames(ring, 3, 9)
    assert (batch.first, batch.ticks.tolist(), batch.planned_ns.tolist()) == (
        3, [3, 4, 5], [103, 104, 105],
    )  # fmt: skip
    assert batch.values.tolist() == [[float(tick)] * n for tick in (3, 4, 5)]
    assert batch.status.tolist() == [[10 * tick] * n for tick in (3, 4, 5)]
    assert len(read_frames(ring, 6, 9)) == 0  # not there yet
    assert ring.frame(3).values.tolist() == [3.0] * n
    assert ring.frame(1) is None
    ring.close()


def test_reader_in_another_process_finds_names_and_values(image):
    frame = image.frame_values
    frame[:] = np.arange(N_DOUBLES)
    publish_frame(7, 123, image.values, image.words)
    reader = ImageReader.attach(image.name)
    latest = reader.latest()
    assert (latest.tick, latest.planned_ns, latest.number) == (7, 123, 0)
    assert latest.values.tolist() == list(range(N_DOUBLES))
    assert reader.description["signals"][3]["name"] == "s3"
    assert reader.frame(5) is None
    with pytest.raises(ValueError, match="read-only"):
        reader.values[0] = 1.0


def test_no_frame_before_the_first(image):
    assert image.latest() is None
