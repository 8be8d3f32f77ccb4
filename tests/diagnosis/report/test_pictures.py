"""Every picture of the report, read back from the drawn SVG: marks, colours, legend, words."""

import re
from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.report import figures, render
from hilserver.diagnosis.report.merging import merged
from hilserver.diagnosis.report.page import MODELS
from hilserver.diagnosis.report.svg import MAX_RUNS, thinned
from hilserver.diagnosis.report.time_series import MAX_MARKS, series
from hilserver.diagnosis.schema.evidence import Evidence, HorizonRow, Path
from hilserver.diagnosis.schema.findings import Parameter
from tests.diagnosis.report.drawing import Drawing
from tests.diagnosis.sample import evidence, findings, gain_of

SVG = re.compile(r"<svg .*?</svg>", re.DOTALL)


@pytest.fixture(scope="module")
def given():
    return evidence(3000)


def rows(*ratios):
    """Gains as the engine reports them: all quantities of one horizon, then of the next."""
    return tuple(
        HorizonRow(quantity, gain_of(h, r, r, ci))
        for h, ci in ((1.0, (1.0, 9.0)), (2.0, (1.0, 9.0)), (5.0, None))
        for quantity, r in zip(("yaw_rad", "position_m"), ratios, strict=True)
    )


def test_nothing_on_the_page_is_drawn_without_a_colour(given):
    page = render(findings(), given)
    kinds = {"line": "stroke", "whisker": "stroke", "begin": "stroke", "dot": "fill",
             "band": "fill", "cell": "fill"}  # fmt: skip
    seen = set()
    for svg in SVG.findall(page):
        for mark in Drawing(svg).marks:
            for kind in mark.classes & set(kinds) - (
                {"begin"} if "dot" in mark.classes else set()
            ):
                seen.add(kind)
                assert mark.colour(kinds[kind]), mark.classes
    assert seen == set(kinds) - {"begin"}  # the sample has one run only


def test_a_gain_has_one_line_one_colour_and_one_word_for_each_quantity():
    drawn = figures.horizons(rows(4.0, 2.0))
    assert [text for _, text in drawn.legend] == ["position", "heading"]
    assert len({role for role, _ in drawn.legend}) == 2
    picture = Drawing(drawn.svg)
    colours = []
    for role, text in drawn.legend:
        (line,) = picture.of("line", *role.split())
        dots = picture.of("dot", *role.split())
        assert line.title.startswith(text)
        assert len(line.points) == len(dots) == 3
        assert all(text in dot.title for dot in dots)
        colours.append(line.colour("stroke"))
        assert {dot.colour("fill") for dot in dots} == {line.colour("stroke"), "card"}
        (bars,) = picture.of("whisker", *role.split())
        assert bars.pieces == 2
    assert None not in colours
    assert len(set(colours)) == 2


def test_a_gain_without_an_interval_is_a_ring_and_the_caption_says_why():
    drawn = figures.horizons(rows(4.0, 2.0))
    rings = Drawing(drawn.svg).of("dot", "ring")
    assert len(rings) == 2
    assert all(
        r.colour("fill") == "card" and r.colour("stroke") != "card" for r in rings
    )
    assert "Rings: too few runs" in drawn.caption
    assert "Rings" not in figures.horizons(rows(4.0, 2.0)[:4]).caption


def test_better_is_above_the_line_and_worse_below_it():
    picture = Drawing(figures.horizons(rows(4.0, 0.5)).svg)
    (level,) = picture.of("level")
    zero = level.points[0][1]
    assert all(dot.at[1] < zero for dot in picture.of("dot", "q1"))
    assert all(dot.at[1] > zero for dot in picture.of("dot", "q0"))
    assert picture.texts("axis-label") == ["free run [s]", "times better"]


def track(n):
    t = np.linspace(0.0, 3.0, n)
    return np.stack([t, np.sin(t)], axis=1)


def test_a_path_shows_where_its_models_begin_anew():
    drawn = figures.path(
        Path(2, track(90), track(90) + 0.1, track(90) + 0.02, begins=(30, 60))
    )
    picture = Drawing(drawn.svg)
    (measured,) = picture.of("line", "measured")
    assert measured.pieces == 1
    for role in ("simulated", "extended"):
        (line,) = picture.of("line", role)
        assert line.pieces == 3
        rings = picture.of("dot", "begin", role)
        assert [r.at for r in rings] == [line.points[k] for k in (0, 31, 62)]
        assert {r.colour("stroke") for r in rings} == {role}
    assert "starts of the 3 model runs" in drawn.caption
    assert drawn.title == "Path, segment 2"
    assert (
        len(
            {m.colour("stroke") for role, _ in MODELS for m in picture.of("line", role)}
        )
        == 3
    )


def test_a_path_is_drawn_to_scale():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    picture = Drawing(figures.path(Path(0, square, square, None)).svg)
    (line,) = picture.of("line", "measured")
    (x0, y0), (x1, _), (_, y2), _ = line.points[:4]
    assert abs(x1 - x0) == pytest.approx(abs(y2 - y0), abs=0.2)


def test_a_channel_has_its_models_above_and_their_residuals_below(given):
    drawn = series(given.series[1])
    picture = Drawing(drawn.svg)
    assert [m.colour("stroke") for m in picture.of("line")] == [
        "measured", "simulated", "extended", "simulated", "extended",
    ]  # fmt: skip
    tops = [min(y for _, y in m.points) for m in picture.of("line")]
    assert max(tops[:3]) < min(tops[3:])
    assert picture.texts("axis-label")[1:] == [
        "value [rad]",
        "time [s]",
        "residual [rad]",
    ]
    assert not picture.of("begin")


def runs(given, n):
    length = len(given.series[1].t_s)
    run = np.arange(length) * n // length
    return replace(given.series[1], run=run)


def test_lines_of_a_channel_break_where_its_models_begin_anew(given):
    drawn = series(runs(given, 5))
    picture = Drawing(drawn.svg)
    assert {m.pieces for m in picture.of("line")} == {5}
    (marks,) = picture.of("begin")
    assert marks.pieces == 4
    assert "restart 4 times, at the marks at the top" in drawn.caption


def test_every_stretch_of_a_long_log_is_drawn(given):
    """Of hundreds of segments only the first sixty were, on an axis for all of them."""
    drawn = series(runs(given, 300))
    for line in Drawing(drawn.svg).of("line"):
        assert line.pieces == 300
        assert line.points[-1][0] == pytest.approx(506.0, abs=3.0)
    assert MAX_MARKS < 300
    assert "where the lines break" in drawn.caption
    assert "Only one run" not in drawn.caption


def test_what_is_left_out_of_a_line_is_said(given):
    drawn = series(runs(given, 2 * MAX_RUNS))
    assert {m.pieces for m in Drawing(drawn.svg).of("line")} == {MAX_RUNS}
    assert "Only one run in 2 is drawn." in drawn.caption


def test_a_run_keeps_its_ends_however_many_there_are():
    x = np.arange(3000.0)
    run = (x // 10).astype(np.int64)
    kept, y = thinned(x, np.sin(x), run)
    finite = np.isfinite(kept)
    assert (~finite).sum() == 300
    assert (np.isnan(y) == ~finite).all()
    assert len(np.unique(run[kept[finite].astype(int)])) == 300


def test_causes_that_look_alike_are_framed(given):
    drawn = figures.likeness(given.similarity)
    picture = Drawing(drawn.svg)
    twins = picture.of("cell", "twin")
    assert {frozenset(m.title.partition(":")[0].split(" / ")) for m in twins} == {
        frozenset({"wheel_radius", "nav_scale"}),
    }
    assert {m.colour("stroke") for m in twins} == {"ink"}
    minus = [m for m in picture.of("cell") if "\N{MINUS SIGN}" in m.title]
    assert minus
    assert {m.colour("fill") for m in minus} == {"simulated"}


def test_a_dependence_lies_in_its_band(given):
    picture = Drawing(figures.dependence(given.dependences[0]).svg)
    (line,), (band,) = picture.of("line"), picture.of("band")
    assert line.colour("stroke") == band.colour("fill") == "extended"
    assert len(band.points) == 2 * len(line.points)
    assert picture.of("level")


def test_a_course_has_a_dot_at_every_window(given):
    picture = Drawing(figures.course(given.courses[0]).svg)
    (line,) = picture.of("line")
    assert [dot.at for dot in picture.of("dot")] == line.points
    assert picture.of("band")


def test_an_interval_stands_beside_its_null():
    picture = Drawing(
        figures.interval(Parameter(value=0.2, ci95=(0.1, 0.3), unit="1"), "gyro_bias")
    )
    (null,), (bar,), (dot,) = (picture.of(c) for c in ("null", "whisker", "dot"))
    assert null.points[0][0] < bar.points[0][0] < dot.at[0]
    assert bar.colour("stroke") == dot.colour("fill") == "extended"


def test_the_legend_of_the_page_names_each_role_once(given):
    page = render(findings(), given)
    for legend in re.findall(r'<ul class="legend">.*?</ul>', page, re.DOTALL):
        words = re.findall(r"</svg>([^<]*)</li>", legend)
        roles = re.findall(r'class="line ([^"]*)"', legend)
        assert len(set(words)) == len(words) == len(set(roles))
        for svg in SVG.findall(legend):
            assert all(mark.colour("stroke") for mark in Drawing(svg).marks)
    assert render(findings(), Evidence()).count('class="legend"') == 0


def test_paths_of_groups_say_whose_they_are(given):
    merged_paths = merged({"tiles": given, "carpet": given}).paths
    titles = [figure.title for figure in figures.paths(merged_paths)]
    assert titles == ["Path, carpet, segment 0", "Path, tiles, segment 0"]


def test_the_size_of_a_path_is_its_ground_not_its_noise():
    noise = 0.01 * np.random.default_rng(0).normal(size=(5000, 2))
    assert Path(0, noise, noise, None).size_m < 0.2
    assert Path(0, track(50), track(50), None).size_m > 3.0
