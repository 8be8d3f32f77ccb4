"""Which causes are said to be behind what was fitted, where several act at once."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.revision import revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.findings.naming import named_findings
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.schema.findings import Verdict
from tests.diagnosis import toy

N = 3000


@pytest.fixture(autouse=True)
def no_families(monkeypatch):
    """A sum of columns has no motion that an unknown structure could depend on."""
    monkeypatch.setattr(
        "hilserver.diagnosis.decide.revision.families_of", lambda *_: []
    )


def found(sizes, seed=3):
    """What is said of a way and a turn that these causes change."""
    rng = np.random.default_rng(seed)
    way, turn, other = (20.0 * toy.smooth(rng, N) for _ in range(3))
    columns = {
        "wheel_radius": way + turn,
        "rotation_gain": turn,
        "nav_scale": way,
        "gyro_bias": other,
    }
    effects = (size * columns[cause] for cause, size in sizes.items())
    problem = toy.problem(sum(effects) + rng.normal(size=N), columns)
    library, base = toy.library(problem)
    chosen = select(problem, library, base, rng)
    return named_findings(revised(Prepared(problem, library, base), chosen, rng))


TRIO = {"wheel_radius", "rotation_gain", "nav_scale", "traction_slip"}


@pytest.mark.parametrize(
    "sizes",
    [
        {"wheel_radius": 0.3, "rotation_gain": -0.12},
        {"wheel_radius": 0.3, "nav_scale": -0.12},
        {"rotation_gain": 0.2, "nav_scale": 0.15},
    ],
)
def test_two_of_three_that_change_two_things_are_one_group(sizes):
    """The sign of a gain beside a radius is another one than beside a scale: none is claimed."""
    findings = found(sizes)
    assert len(findings) == 2
    for finding in findings:
        assert finding.verdict == Verdict.NAMED_GROUP
        assert set(finding.causes) == TRIO
        assert finding.explanation.startswith("Two of these, ")
        for cause, size in sizes.items():
            low, high = finding.parameters[cause].ci95
            assert low < size < high


def test_a_slip_is_said_where_only_a_rival_of_what_was_fitted_looks_like_it():
    for finding in found({"wheel_radius": -0.5, "rotation_gain": 0.9}):
        low, high = finding.parameters["traction_slip"].ci95
        assert low < 0.5 < high


@pytest.mark.parametrize(
    "sizes", [{"rotation_gain": 0.7}, {"wheel_radius": 0.7}, {"gyro_bias": 0.5}]
)
def test_one_of_them_alone_has_its_name(sizes):
    (finding,) = found(sizes)
    assert finding.causes == tuple(sizes)


def test_a_cause_with_no_common_rival_keeps_a_name_of_its_own():
    findings = found({"wheel_radius": 0.3, "rotation_gain": -0.12, "gyro_bias": 0.6})
    alone = [f.causes for f in findings if f.verdict == Verdict.NAMED]
    assert alone == [("gyro_bias",)]
    assert len(findings) == 3
