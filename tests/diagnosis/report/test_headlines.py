"""A headline says of the robot only what was judged, and of two sets only how they differ."""

import pytest

from hilserver.diagnosis.marks.judging import TOO_FEW
from hilserver.diagnosis.report import render
from hilserver.diagnosis.report.summary import summary
from hilserver.diagnosis.report.words import headline, steps
from hilserver.diagnosis.schema.evidence import Evidence
from hilserver.diagnosis.schema.findings import Finding, Noise, NotJudged, Verdict
from tests.diagnosis.sample import findings, nothing_found

FAULT = findings().findings[3]
CAUSE = findings().findings[0]
LACKING = (
    NotJudged(
        cause="process_gain",
        reason="no set-points in the log, no wheel speed in the log",
    ),
    NotJudged(cause="rotation_gain", reason="no wheel speed on both sides"),
    NotJudged(cause="missed_ticks", reason="the log has no tick counter"),
)
EXCITED = (
    NotJudged(cause="side_slip", reason="hardly excited: this drive cannot show it"),
)


def said(*found, not_judged=LACKING, judged=True, verdict="findings"):
    sizes = findings().smallest_detectable if judged else ()
    changed = {
        "smallest_detectable": sizes,
        "not_judged": not_judged,
        "verdict": verdict,
    }
    given = nothing_found().model_copy(update={"findings": found, **changed})
    assert summary(given).replace("\n  ", " ").startswith(headline(given))
    return headline(given)


@pytest.mark.parametrize("faults", [0, 1, 2])
def test_where_nothing_was_judged_the_robot_is_not_said_to_be_sound(faults):
    text = said(*[FAULT] * faults, judged=False, verdict="not_judged")
    assert (
        "othing about the robot could be judged (no set-points, no wheel speed on both"
        in text
    )
    assert "none in" not in text
    assert (f"{('', 'One fault', 'Two faults')[faults]} in the rec" in text) == (
        faults > 0
    )


@pytest.mark.parametrize("faults", [1, 2])
def test_where_a_part_was_judged_none_is_said_of_that_part(faults):
    assert said(*[FAULT] * faults).endswith(
        "in the recording, none in what could be judged of the robot (no set-points,"
        " no wheel speed on both sides)."
    )
    assert said(FAULT, FAULT, not_judged=EXCITED) == (
        "Two faults in the recording, none in the robot."
    )


def test_a_simulation_matches_what_was_judged():
    text = said(verdict="nothing_found")
    assert text.startswith("In what could be judged (no set-points, ")
    assert said(verdict="nothing_found", not_judged=EXCITED) == (
        "The simulation matches these data: nothing was found."
    )


@pytest.mark.parametrize(("error_m", "matches"), [(0.6, True), (2.6, False)])
def test_an_error_far_above_the_noise_is_never_said_to_match(error_m, matches):
    """Signs of the wheels that are wrong, seen by satellites whose fitted error takes it all."""
    noise = Noise(
        white_sd=0.007, ou_sd=1.0, ou_tau_s=60.0, tail_dof=None, step=None, limits=None
    )
    given = nothing_found().model_copy(
        update={
            "baseline": {"position_m": error_m},
            "noise": {"nav.x_m": noise, "nav.y_m": noise},
            "not_judged": EXCITED,
        }
    )
    assert ("simulation matches" in headline(given)) == matches
    assert ("error remains that no known cause explains" in headline(given)) != matches


def differing(*found, **more):
    return said(
        *found, verdict="differs" if DIFFERENCE in found else "no_difference", **more
    )


DIFFERENCE = Finding(
    verdict="differs",
    causes=("rotation_gain",),
    block="kinematics",
    explanation="The two sets differ: rotation_gain: 0 before, 0.1 after.",
)


def test_faults_of_two_sets_are_no_difference():
    assert "0.1 after" in differing(DIFFERENCE, FAULT)
    assert "in two ways" in differing(DIFFERENCE, DIFFERENCE, FAULT, FAULT)
    assert (
        differing(FAULT, not_judged=EXCITED)
        == "The two sets of recordings do not differ."
    )
    assert differing(FAULT).startswith("In what could be judged (no set-points")


@pytest.mark.parametrize("name", [None, "model_patch.yaml"])
def test_a_patch_is_advised_where_there_is_one(name):
    page = render(findings(findings=(CAUSE,), model_patch=name), Evidence())
    assert ("apply the patch" in page) == (name is not None)


def test_what_only_acts_like_a_cause_is_said_so():
    """It asserts nothing about the robot, so it asks for no repair."""
    one = CAUSE.model_copy(update={"verdict": Verdict.EFFECTIVE, "explanation": ""})
    found = findings(findings=(one,))
    assert headline(found).startswith("It acts as if this were so: the robot turns 47")
    assert "what is behind it, these data do not tell" in headline(found)
    (step,) = steps(found)
    assert "no change" in step.text


def test_what_too_few_marks_leave_open_is_not_said_to_match():
    few = (NotJudged(cause="wheel_radius", reason=TOO_FEW),)
    text = said(not_judged=few, verdict="nothing_found")
    assert text.startswith("In what could be judged (no marks of enough runs)")
