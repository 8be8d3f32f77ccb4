"""How the step applies a change of parameters: as a whole, with the state carried over."""

from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.records import record_at
from hilserver.image import changes, word
from hilserver.kernel.places import Places, p, x
from hilserver.plant.carry_over import carry_over
from hilserver.plant.layout import PARAMETERS


@inlined
def _take(row: int, at: Places, values: Any, words: Any) -> None:
    carry_over(p(at, values), record_at(values, row, PARAMETERS), x(at, values))
    first = words[word.PARAMETERS_BASE]
    for i in range(words[word.PARAMETERS_LENGTH]):
        words[first + i] = words[row + i]


@inlined
def drop_changes(tick: int, words: Any) -> None:
    """Skip pending changes: the state that was loaded brings its own parameters."""
    head, tail = load_acquire(words, word.CHANGES_HEAD), words[word.CHANGES_TAIL]
    stride = changes.PACKED + words[word.PARAMETERS_LENGTH]
    while tail < head:
        row = words[word.CHANGES_BASE] + (tail & (changes.ROWS - 1)) * stride
        words[row + changes.TAKEN] = tick
        tail += 1
    store_release(words, word.CHANGES_TAIL, tail)


@part
def take_changes(tick: int, at: Places, values: Any, words: Any) -> None:
    """Apply the changes that are due, in the order in which they were posted."""
    head, tail = load_acquire(words, word.CHANGES_HEAD), words[word.CHANGES_TAIL]
    stride = changes.PACKED + words[word.PARAMETERS_LENGTH]
    while tail < head:
        row = words[word.CHANGES_BASE] + (tail & (changes.ROWS - 1)) * stride
        if words[row + changes.DUE] > tick:
            break
        _take(row + changes.PACKED, at, values, words)
        words[row + changes.TAKEN] = tick
        tail += 1
    store_release(words, word.CHANGES_TAIL, tail)
