"""What is reported of one stage besides fitted causes."""

from types import SimpleNamespace

import pytest

from hilserver.diagnosis.decide.structure import Family, Unknown
from hilserver.diagnosis.findings import outcome


@pytest.mark.parametrize(
    ("late", "said"),
    [
        ((0, 120), ["unknown"]),
        ((2, 120), ["unknown"]),
        ((4, 120), ["lost", "unknown"]),
        ((40, 120), ["lost"]),
        ((14, 2000), ["lost", "unknown"]),
    ],
)
def test_only_many_lost_set_points_explain_what_else_is_unknown(
    monkeypatch, late, said
):
    """One event of four wheels is four late steps."""
    problem = SimpleNamespace(stage=SimpleNamespace(block="drive"))
    family = Family("speed", ("wheel.fl.speed_rpm",), None)
    prepared = SimpleNamespace(problem=problem, coarse_rpm=None)
    judged = SimpleNamespace(
        prepared=prepared,
        point=None,
        anchor=None,
        unknown=[Unknown(family, 9.0, 9.0, 1e-4, 99.0)],
    )
    monkeypatch.setattr(outcome, "outliers", lambda *_: None)
    monkeypatch.setattr(outcome, "deviating", lambda *_: {})
    monkeypatch.setattr(outcome, "lost_steps", lambda *_: late)
    found = outcome.other_findings(judged)
    lost = ["lost" if "lost on the way" in f.explanation else "unknown" for f in found]
    assert lost == said
