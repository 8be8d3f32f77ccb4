"""The plant and the independent C program both reproduce the shipped vectors."""

import numpy as np
import pytest

from hilserver.plant.packing import initial_state
from hilserver.plant.reference import library
from hilserver.plant.reference.cases import cases
from hilserver.plant.terms import TERMS
from tests.plant import vectors

CASES = list(cases())


def assert_close(name, found, wanted, relative):
    scale = np.maximum(np.max(np.abs(wanted), axis=0), 1e-3)
    error = np.max(np.abs(found - wanted) / scale, axis=0)
    worst = int(np.argmax(error))
    assert error[worst] <= relative, (
        f"{name}: {vectors.COLUMNS[worst]} off by {error[worst]:.3g}"
    )


def test_every_term_has_a_vector():
    unnamed = {t.name for t in TERMS.values() if not t.shape} - set(CASES)
    assert not unnamed


@pytest.mark.parametrize("name", CASES)
def test_plant_reproduces(name):
    terms, ticks, wanted = vectors.read(name)
    assert terms == cases()[name]
    found = dict(vectors.drive(vectors.robot_of(terms)))
    assert_close(name, np.array([found[t] for t in ticks]), wanted, 1e-12)


def c_numbers(c_library, terms, ticks, *, extended):
    robot = vectors.robot_of(terms)
    battery_v = initial_state(robot).battery_v
    plant = library.ReferencePlant(
        c_library, robot, battery_v=battery_v, extended=extended
    )
    rows = []
    for tick in range(vectors.TICKS):
        plant.tick(vectors.setpoints(tick))
        if tick % vectors.SENSOR_TICKS == 0:
            plant.sense()
        if tick in ticks:
            rows.append(np.concatenate([plant.outputs, plant.states, plant.sensors]))
    plant.close()
    return np.array(rows)


@pytest.mark.parametrize("name", CASES)
def test_c_reproduces(c_library, name):
    terms, ticks, wanted = vectors.read(name)
    assert_close(
        name, c_numbers(c_library, terms, set(ticks), extended=True), wanted, 1e-9
    )


def test_c_base_step_reproduces_the_base(c_library):
    _, ticks, wanted = vectors.read("base")
    assert_close(
        "base", c_numbers(c_library, {}, set(ticks), extended=False), wanted, 1e-9
    )


def test_vectors_differ_from_the_base():
    _, _, base = vectors.read("base")
    for name in CASES[1:]:
        assert not np.allclose(vectors.read(name)[2], base, rtol=1e-6, atol=0), name
