"""Records: the words of an array by name, the same ones in Python and in a kernel."""

import pickle
from typing import Annotated, Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from hilserver.compiled import kernel
from hilserver.compiled.records import Record, record_at

Scalar = TypeVar("Scalar", bound=np.generic)
# How NumPy 2.5 spells NDArray on Python 3.12, with a ``type`` statement.
Alias = TypeAliasType("Alias", np.ndarray[Any, np.dtype[Scalar]], type_params=(Scalar,))

Pair = Annotated[NDArray[np.float64], 2]
Table = Annotated[NDArray[np.float64], (3, 2)]


class Motion(Record):
    time: float
    pair: Pair
    table: Table
    ticks: int


class Codes(Motion, word=np.int64):
    """The same places, whole numbers."""


MOTION, CODES = Motion.layout, Codes.layout


@kernel()
def drive(values, words, place):
    x, q = record_at(values, place, MOTION), record_at(words, place, CODES)
    x.time += 0.5
    x.ticks += 1
    for i in range(2):
        x.pair[i] = 10.0 + i
        x.table[2, i] = x.pair[i] * x.time
    q.table[0, 1] = 7


def test_a_kernel_and_python_see_the_same_words():
    values = np.zeros(30)
    words = np.zeros(30, dtype=np.int64)
    drive(values, words, 15)
    x, q = Motion.of(values, 15), Codes.of(words, 15)
    assert (x.time, x.ticks, x.pair.tolist()) == (0.5, 1, [10.0, 11.0])
    assert values[15:].view(np.int64)[9] == 1
    assert values[15:24].tolist() == [0.5, 10, 11, 0, 0, 0, 0, 5, 5.5]
    assert np.flatnonzero(words).tolist() == [15 + 4]
    assert q.table[0, 1] == 7
    x.pair[0], x.time = 3.0, 4.0
    assert values[15:17].tolist() == [4.0, 3.0]


def test_a_kernel_takes_records_as_arguments():
    @kernel()
    def add(x, y):
        x.time += y.pair[1]

    x, y = Motion.zeros(), Motion.zeros()
    y.pair[:] = 1.0, 2.0
    add(x, y)
    assert x.time == 2.0


def test_words_lie_in_the_order_of_the_annotations():
    assert Motion.n_words == Codes.n_words == 10
    places = [Motion.where(name) for name in ("time", "pair", "table", "ticks")]
    assert places == [slice(0, 1), slice(1, 3), slice(3, 9), slice(9, 10)]


def test_a_copy_has_its_own_memory_and_so_has_one_from_another_process():
    x = Motion.zeros()
    x.pair[:] = 1.0, 2.0
    for other in (x.copy(), pickle.loads(pickle.dumps(x))):
        assert other.tobytes() == x.tobytes()
        other.pair[1] = other.time = 5.0
        assert other.numbers[:3].tolist() == [5.0, 1.0, 5.0]
    assert x.numbers[:3].tolist() == [0.0, 1.0, 2.0]


def test_names_that_do_not_exist_are_refused():
    x = Motion.zeros()
    with pytest.raises(AttributeError, match="speed"):
        _ = x.speed
    with pytest.raises(ValueError, match="speed"):
        x.speed = 1.0


def test_a_field_may_not_hide_what_every_record_has():
    with pytest.raises(TypeError, match=r"Wrong\.layout"):

        class Wrong(Record):
            layout: float


@pytest.mark.parametrize(
    "spelled",
    [
        NDArray[np.int64],
        Alias[np.int64],
        np.ndarray[Any, np.dtype[np.int64]],
        np.ndarray[tuple[int, ...], np.dtype[np.int64]],
    ],
)
def test_an_array_has_its_element_type_however_numpy_spells_the_annotation(spelled):
    class Counts(Record):
        ticks: Annotated[spelled, 3]

    assert Counts.zeros().ticks.dtype == np.int64
    assert Counts.zeros().ticks.shape == (3,)


def test_records_lie_in_a_list_of_records():
    class Trip(Record):
        motions: Annotated[list[Motion], 2]

    trip = Trip.zeros()
    trip.motions[1].time = 2.0
    assert trip.numbers[Motion.n_words] == 2.0


@pytest.mark.parametrize(
    "hint", [Annotated[NDArray, 3], Annotated[list[str], 3], str, "float"]
)
def test_an_annotation_without_a_number_is_refused_by_name(hint):
    with pytest.raises(TypeError, match=r"Trip\.place"):

        class Trip(Record):
            place: hint
