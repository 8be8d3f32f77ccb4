"""Each of these one-line mistakes in the engine makes a named assertion of the suite fail.

A mutated engine that crashes proves nothing: whatever is no `AssertionError` is an error here, too.
"""

import pytest

from hilserver.diagnosis.decide import identifiability
from hilserver.diagnosis.findings import gain
from hilserver.diagnosis.regression import screen
from hilserver.plant import packing
from tests.diagnosis import toy
from tests.diagnosis.assertions import (
    family_wise_error_holds,
    no_prediction_saw_its_block,
    nothing_is_found,
    the_twins_are_one_group,
)
from tests.diagnosis.hidden.logs import diagnosis, judged, recipe
from tests.diagnosis.mutation import mutated
from tests.diagnosis.regression.test_fits import drawn, spoil
from tests.diagnosis.regression.test_screen import null_draws

TWINS = ("wheel_misalignment", 1, 120.0)
NULL = ("nothing drive", 103, 60.0)


def no_finding_without_an_effect():
    family_wise_error_holds(null_draws(100), level=screen.SCREEN_LEVEL, most=0.01)


def held_out_means_held_out():
    no_prediction_saw_its_block(drawn(5), toy.model("c0", "c1"), spoil)


def test_naive_variance_instead_of_the_robust_one():
    no_finding_without_an_effect()
    line = "deviation = np.sqrt(np.maximum(scatter, safe))"
    with (
        mutated(screen.score, line, "deviation = np.sqrt(safe)"),
        pytest.raises(AssertionError, match="logs without an effect"),
    ):
        no_finding_without_an_effect()
    no_finding_without_an_effect()


def test_flips_that_are_not_fitted_anew():
    line = "deviation = np.sqrt(np.maximum(scatter, information))"
    changed = "deviation = np.sqrt((rest**2).sum(axis=0) + 1e-300)"
    with (
        mutated(screen.null_maxima, line, changed),
        pytest.raises(AssertionError, match="logs without an effect"),
    ):
        no_finding_without_an_effect()


def test_twin_check_off():
    the_twins_are_one_group(diagnosis(*TWINS).findings, "wheel_misalignment", "nav_frame_yaw")
    with mutated(identifiability.settle, "if r.ties]", "if False]"):
        findings = judged(recipe(*TWINS)).findings
    assert len(findings.findings) == 1
    with pytest.raises(AssertionError, match="named: "):
        the_twins_are_one_group(findings, "wheel_misalignment", "nav_frame_yaw")


def test_held_out_blocks_shuffled():
    held_out_means_held_out()
    line = "fold = problem.stack.fold[problem.stack.block]"
    shuffled = f"fold = np.random.default_rng(0).permutation({line.removeprefix('fold = ')})"
    everything = "train = problem.stack.fold >= 0"
    for function, right, wrong in (
        (gain.held_out, line, shuffled),
        (gain.crossed, "train = problem.stack.fold != test", everything),
    ):
        with mutated(function, right, wrong), pytest.raises(AssertionError, match="its own block"):
            held_out_means_held_out()
    held_out_means_held_out()


def test_the_plants_sign_flipped():
    nothing_is_found(diagnosis(*NULL).findings)
    line = "p[at.P_YAW_GAIN] = robot.yaw_sign * ("
    flipped = line.replace("robot.yaw_sign", "-robot.yaw_sign")
    with mutated(packing._pack_kinematics, line, flipped):
        findings = judged(recipe(*NULL)).findings
    with pytest.raises(AssertionError, match=r"data_fault|named|structure"):
        nothing_is_found(findings)
