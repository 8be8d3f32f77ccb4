"""State: the same bits again, mid-collision too; what is no longer good is said."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.body.engine import BodyEngine
from hilserver.body.parameters import BodyParameters, Tyre
from hilserver.body.step import advance
from hilserver.plant.errors import PlantError
from hilserver.plant.hall import Solid, wall_solids
from hilserver.plant.parameters import RobotParameters
from tests.body.rig import Body

WALL = wall_solids(np.array([0.35, -2.0, 0.5, 2.0]))
STEP_S = 0.001


def test_a_copy_of_the_state_goes_on_with_the_same_bits_in_another_engine():
    one, other = (
        Body(solids=WALL, torque=True, sensors=True),
        Body(solids=WALL, torque=True, sensors=True),
    )
    one.run(0.4, 90.0, 90.0, 60.0, 60.0)
    other.run(1.0, -50.0, 20.0, 60.0, 60.0)  # leaves what it likes in MuJoCo's memory
    other.numbers[:] = one.numbers
    one.run(0.5, 90.0, 90.0, 60.0, 60.0)
    other.run(0.5, 90.0, 90.0, 60.0, 60.0)
    assert one.place[0] < 0.3  # it stands at the wall
    assert one.numbers.tobytes() == other.numbers.tobytes()


def test_a_bad_number_ends_the_run_and_is_no_silent_reset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = Body().run(0.1, 3.0, 3.0, 3.0, 3.0)
    body.b.velocity[0] = 1e12
    assert not advance(body.engine.parameters, body.numbers, body.engine.addresses)
    assert body.b.velocity[0] != 0.0
    assert np.any(body.b.warnings != 0.0)
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT


speeds = st.lists(st.floats(-12.0, 12.0), min_size=4, max_size=4)
boxes = st.builds(
    lambda x, y, size, height, yaw: Solid(
        (x, y, height / 2), (size, size, height / 2), yaw
    ),
    st.floats(0.5, 1.0),
    st.floats(-0.5, 0.5),
    st.floats(0.02, 0.2),
    st.floats(0.005, 0.4),
    st.floats(-3.0, 3.0),
)


@settings(max_examples=10, deadline=None)
@given(st.lists(boxes, max_size=3), st.lists(speeds, min_size=1, max_size=3))
def test_whatever_stands_there_all_numbers_stay_finite_and_energy_bounded(
    solids, commands
):
    body = Body(solids=[*WALL, *solids])
    for asked in commands:
        body.run(0.4, *asked)  # asserts that every slice was good
    assert np.all(np.isfinite(body.numbers))
    assert np.linalg.norm(body.b.velocity) < 2.0 * 12.0 * 0.085
    assert body.place[2] < 0.5


@pytest.mark.long
def test_a_million_random_steps_make_no_energy():
    """Half a second takes more out of body and wheels than it adds to what the drives put in."""
    random = np.random.default_rng(1)
    body = Body(solids=WALL, torque=True, sensors=True, slice_s=STEP_S).run(
        0.5, *[0.0] * 4
    )
    before_j = body.energy_j
    for _ in range(2000):
        asked, work_j = random.uniform(-100.0, 100.0, 4), 0.0
        for _ in range(500):
            speeds = body.b.speed.copy()
            body.run(STEP_S, *asked)
            work_j += body.b.torque @ (0.5 * (speeds + body.b.speed)) * STEP_S
        assert body.energy_j - before_j < work_j
        before_j = body.energy_j


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"step_s": 0.0015}, "multiple of step_ms"),
        (
            {"tyre": Tyre(v0_m_s=0.003)},
            r"step_ms: 1 ms is too long for this tyre: .*v0_m_s",
        ),
        ({"centre_of_mass_m": (0.2, 0.0, 0.06)}, "falls over"),
        ({"mass_kg": math.nan}, "mass_kg"),
        ({"inertia_kg_m2": (0.1, 0.01, 0.01)}, "no moment may exceed"),
    ],
)
def test_what_cannot_stand_or_step_is_refused(changes, words):
    with pytest.raises(PlantError, match=words):
        BodyParameters(robot=RobotParameters(), **changes)


def test_without_the_extra_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr("hilserver.body.engine.find_spec", lambda _: None)
    with pytest.raises(PlantError, match=r"pip install 'hilserver\[physics\]'"):
        BodyEngine(BodyParameters(robot=RobotParameters()))
