"""A plan as a page: everything that plan.json says, and nothing loaded."""

from hilserver.diagnosis.plan.document import (
    Group,
    Missing,
    PlanDocument,
    Proposed,
    Prospect,
    Visible,
)
from hilserver.diagnosis.plan.text import lines
from hilserver.diagnosis.report.plan_page import render_plan
from hilserver.diagnosis.schema.findings import NotJudged
from tests.diagnosis.report.test_page import Reader


def visible(cause, size, *, shows):
    return Visible(cause=cause, size=size, unit="m", reference=0.02, shows=shows)


def document(*, better=True, satellites_m=None):
    planned = Prospect(
        duration_s=20.0,
        score=1.0,
        causes=(visible("icr_offset", 0.05, shows=False),),
        groups=(),
        not_judged=(),
    )
    proposed = Proposed(
        duration_s=60.0,
        score=2.0,
        causes=(
            visible("icr_offset", 0.01, shows=True),
            visible("side_slip", 0.3, shows=False),
        ),
        groups=(
            Group(causes=("a", "b"), cosine=0.99, separating_experiment="Use a tape."),
        ),
        not_judged=(NotJudged(cause="backlash", reason="not planned"),),
        better=better,
        pieces=("circle left", "straight", "straight"),
        scenario="manoeuvre.yaml",
    )
    return PlanDocument(
        version="1",
        config_sha256="c0",
        seed=0,
        manoeuvre="drive <3>.yaml",
        channels=("nav.x_m",),
        rate_hz=50.0,
        navigation_hz=20.0,
        satellites_m=satellites_m,
        room_m=(5.0, 5.0),
        as_planned=planned,
        proposed=proposed,
        missing_channels=(
            Missing(channel="imu", signals=(), shows=("gyro_bias",), separates=()),
        ),
        notices=("drive.yaml leaves 5 m x 5 m",),
    )


def test_the_terminal_says_where_the_position_comes_from():
    assert lines(document())[0] == "Recorded: set-points, position; 50 rows per second"
    by = "position by satellites (0.5 m, no heading)"
    assert by in lines(document(satellites_m=0.5))[0]


def test_the_page_says_what_the_plan_says():
    page = render_plan(document())
    reader = Reader(page)
    assert reader.open == []
    assert {f"#{name}" for name in reader.ids} == set(reader.references)
    assert reader.ids == ["drive", "seen", "groups", "missing", "unjudged"]
    assert "shows 0 causes; the proposed manoeuvre shows 1." in reader.text
    for words in (
        "straight, 2 times",
        "Use a tape.",
        "gyro_bias",
        "backlash",
        "not at all",
    ):
        assert words in reader.text
    assert "<b>0.01\u00a0m</b>" in page
    assert "<3>" not in page


def test_where_nothing_better_was_found_it_says_so():
    text = Reader(render_plan(document(better=False))).text
    assert "no better manoeuvre was found" in text
