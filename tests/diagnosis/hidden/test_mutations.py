"""Each of these one-line mistakes in the engine makes a named assertion of the suite fail.

A mutated engine that crashes proves nothing: whatever is no `AssertionError` is an error here, too.
"""

import numpy as np
import pytest

from hilserver.diagnosis.decide import identifiability, structure, trial
from hilserver.diagnosis.noise.readings import Reading
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.regression import fitting, gain, screen
from hilserver.diagnosis.regression.problem import Problem
from hilserver.plant import constants
from tests.diagnosis import toy
from tests.diagnosis.assertions import (
    family_wise_error_holds,
    no_prediction_saw_its_block,
    nothing_is_found,
    the_twins_are_one_group,
)
from tests.diagnosis.decide.test_first_choice import selected, two_and_a_lure
from tests.diagnosis.hidden.logs import diagnosis, judged, recipe
from tests.diagnosis.mutation import mutated
from tests.diagnosis.noise.test_readings import read
from tests.diagnosis.regression.test_fits import drawn, spoil
from tests.diagnosis.regression.test_screen import null_draws

TWINS = ("wheel_misalignment", 1, 120.0)
NULL = ("nothing drive", 103, 60.0)


def no_finding_without_an_effect():
    family_wise_error_holds(null_draws(100), level=screen.SCREEN_LEVEL, most=0.01)


def held_out_means_held_out():
    no_prediction_saw_its_block(drawn(5), toy.model("c0", "c1"), spoil)


def what_no_machine_has_is_left():
    noise, columns = two_and_a_lure()
    found = selected(0.6 * columns["a"] + 0.6 * columns["b"] + noise, columns)
    assert "lure" not in found.point.model.causes, "far larger than its prior"


def readings_at_a_limit_are_censored():
    limit, noise_sd = 100.0, 0.15
    exact = np.full(100_000, limit)
    said = Reading(0.0, 0.0, limit).mean(exact, NoiseModel(noise_sd))[0]
    shown = read(exact, noise_sd, 0.0, limit).mean()
    assert said == pytest.approx(shown, abs=0.03 * noise_sd), "readings at the limit"


def nothing_is_replaced_by_what_shows_in_one_block():
    """What is fitted to one block says nothing of the others, so it saves nothing there."""
    made = drawn(6)
    own = (made.stack.block == 0).astype(float)
    saved = structure.saved_held_out(made, own[:, None], 5.0 * own)
    assert saved == pytest.approx(0.0), "saved in the block that it was fitted to"


class Turned(toy.LinearStage):
    """Two columns that share one parameter, the angle between them: far from linear."""

    def predict(self, terms, poses=None, *, keep=False):
        angle = terms.get("angle", 0.0)
        return np.sin(angle) * self.columns["a"] + np.cos(angle) * self.columns["b"]


def a_fit_follows_the_curve():
    rng = np.random.default_rng(7)
    columns = {name: 30.0 * toy.smooth(rng, 2400) for name in "ab"}
    truth = Turned(np.zeros(2400), columns).predict({"angle": 1.35})
    made = Problem(Turned(truth + rng.normal(size=2400), columns))
    made.noise = toy.problem(truth, columns).noise
    model = toy.model("angle")
    found = fitting.fit(made, model, made.point(model, np.zeros((0, 3))))
    assert found.model.theta() == pytest.approx([1.35], abs=0.01), (
        "stopped short of the bottom"
    )


@pytest.mark.parametrize(
    ("function", "line", "changed", "holds", "says"),
    [
        pytest.param(
            trial.implausible,
            "return max(away) > SELECTION_PLAUSIBLE_SD * f.candidate.prior",
            "return False",
            what_no_machine_has_is_left,
            "larger than its prior",
            id="priors off",
        ),
        pytest.param(
            Reading.mean,
            "if noise is None or math.isinf(self.limit):",
            "if True:",
            readings_at_a_limit_are_censored,
            "readings at the limit",
            id="censoring off",
        ),
        pytest.param(
            structure.saved_held_out,
            "size = ridge(columns[fold != test], target[fold != test])",
            "size = ridge(columns, target)",
            nothing_is_replaced_by_what_shows_in_one_block,
            "block that it was fitted to",
            id="removals without held-out blocks",
        ),
        pytest.param(
            fitting.fit,
            "problem.columns(point, point.model)",
            "problem.columns(start, model)",
            a_fit_follows_the_curve,
            "stopped short",
            id="sensitivities of the start only",
        ),
    ],
)
def test_what_the_search_rests_on(function, line, changed, holds, says):
    holds()
    with mutated(function, line, changed), pytest.raises(AssertionError, match=says):
        holds()
    holds()


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
    line = "rest**2).sum(axis=0), (own**2).sum(axis=0)"
    changed = (
        "rest**2).sum(axis=0), (own**2).sum(axis=0) * 0.0\n        own = own * 0.0"
    )
    with (
        mutated(screen.null_maxima, line, changed),
        pytest.raises(AssertionError, match="logs without an effect"),
    ):
        no_finding_without_an_effect()


def test_twin_check_off():
    the_twins_are_one_group(
        diagnosis(*TWINS).findings, "wheel_misalignment", "nav_frame_yaw"
    )
    with mutated(identifiability.with_best_rivals, "if r.ties]", "if False]"):
        findings = judged(recipe(*TWINS)).findings
    assert len(findings.findings) == 1
    with pytest.raises(AssertionError, match="named: "):
        the_twins_are_one_group(findings, "wheel_misalignment", "nav_frame_yaw")


def test_held_out_blocks_shuffled():
    held_out_means_held_out()
    line = "fold = problem.stack.fold[problem.stack.block]"
    shuffled = (
        f"fold = np.random.default_rng(0).permutation({line.removeprefix('fold = ')})"
    )
    everything = "train = problem.stack.fold >= 0"
    for function, right, wrong in (
        (gain.held_out, line, shuffled),
        (gain.crossed, "train = problem.stack.fold != test", everything),
    ):
        with (
            mutated(function, right, wrong),
            pytest.raises(AssertionError, match="its own block"),
        ):
            held_out_means_held_out()
    held_out_means_held_out()


def test_the_plants_sign_flipped():
    nothing_is_found(diagnosis(*NULL).findings)
    line = "p.yaw_gain = v.yaw_sign * ("
    flipped = line.replace("v.yaw_sign", "-v.yaw_sign")
    with mutated(constants._kinematics, line, flipped):
        findings = judged(recipe(*NULL)).findings
    with pytest.raises(AssertionError, match=r"data_fault|named|structure"):
        nothing_is_found(findings)
