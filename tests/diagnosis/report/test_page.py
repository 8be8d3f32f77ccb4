"""The page holds everything that it was given, loads nothing, and is well formed."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from hilserver.diagnosis.findings.explain import MINUS
from hilserver.diagnosis.report import render
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.report.summary import summary
from hilserver.diagnosis.report.words import RatioInWords
from hilserver.diagnosis.schema.evidence import Evidence
from hilserver.diagnosis.schema.findings import ON_OTHER_LOGS, Finding
from hilserver.signals import Ranges, robot_table
from tests.diagnosis.sample import evidence, findings, gain, nothing_found

VOID = {"meta", "br"}


class Reader(HTMLParser):
    """Checks that every element is closed, and collects ids, texts and references."""

    def __init__(self, page):
        super().__init__()
        self.open, self.ids, self.references, self.texts = [], [], [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        self.references += [v for n, v in attrs if n in ("src", "href", "xlink:href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(self.texts)


@pytest.fixture(scope="module")
def page():
    return render(findings(), evidence())


def test_it_is_one_well_formed_file_that_loads_nothing(page):
    reader = Reader(page)
    assert reader.open == []
    assert {f"#{name}" for name in reader.ids} >= set(reader.references)
    assert not re.search(r"https?://|@import|url\(", page)
    assert len(page.encode()) < 2_000_000


def test_all_sections_are_there_in_their_order(page):
    ids = Reader(page).ids
    assert " ".join(ids) == (
        "found data do paths channels gain courses rest cuts screen selection twins noise sizes"
        " unjudged origin"
    )


def test_words_come_first_and_say_how_much_better(page):
    text = Reader(page).text
    assert (
        "Three things differ from the simulation, and the recording has one fault."
        in text
    )
    assert "turns 47\u00a0% less" in text
    assert "0.31\u00a0rad to 0.04\u00a0rad" in text
    assert "tape" in text
    assert "hilserver run --patch model_patch.yaml" in text


def test_one_finding_is_the_headline_itself():
    one = findings(findings=findings().findings[:1])
    assert "<h1>The robot turns 47\u00a0% less" in render(one, Evidence())


def test_text_from_outside_cannot_be_markup(page):
    assert "hall &lt;3&gt;.csv" in page
    assert "hall <3>" not in page
    nasty = Finding(
        verdict="named", causes=("gyro_bias",), block="inertial", explanation="<script>"
    )
    assert "<script" not in render(findings(findings=(nasty,)), Evidence())


def test_nothing_found_says_so_and_shows_what_would_have_been_seen():
    page = render(nothing_found(), evidence(500))
    assert "nothing was found" in page
    assert 'id="sizes"' in page
    assert 'id="do"' not in page


def test_without_evidence_what_the_findings_hold_stands_alone():
    ids = Reader(render(findings(), Evidence())).ids
    assert ids == [
        "found",
        "data",
        "do",
        "selection",
        "noise",
        "sizes",
        "unjudged",
        "origin",
    ]


@pytest.mark.parametrize("verdict", ["differs", "no_difference"])
def test_a_comparison_has_its_own_headline(verdict):
    one = findings().findings[0].model_copy(update={"verdict": verdict})
    page = render(findings(verdict=verdict, findings=(one, one)), Evidence())
    assert "differ" in Reader(page).text.split("measured")[0]


def test_hundred_segments_that_all_begin_at_zero_follow_each_other():
    given = evidence(20_000)
    span = np.repeat(np.arange(200), 100)
    t = np.tile(np.arange(100) * 0.02, 200)
    series = tuple(replace(s, t_s=t, run=span) for s in given.series)
    page = render(findings(), replace(given, series=series))
    assert len(page.encode()) < 2_000_000
    assert Reader(page).open == []


def test_channels_that_do_not_change_are_folded_away(page):
    before, _, folded = page.partition(
        "Channels that the extended model leaves unchanged"
    )
    assert "<h3>The navigation&#39;s heading</h3>" in before
    assert "<h3>The speed of the front left wheel</h3>" not in before
    assert "<h3>The speed of the front left wheel</h3>" in folded


def test_the_contents_lead_to_every_section(page):
    contents = page[page.index("<nav") : page.index("</nav>")]
    reader = Reader(contents)
    assert reader.references == [f"#{name}" for name in Reader(page).ids]


def test_what_stands_behind_the_findings_is_folded(page):
    for name in (
        "cuts",
        "screen",
        "selection",
        "twins",
        "noise",
        "sizes",
        "unjudged",
        "origin",
    ):
        assert f'<section id="{name}"><details><summary><h2>' in page
    assert '<section id="found"><h2>' in page


def test_the_gain_over_horizons_is_one_plot(page):
    section = page[
        page.index('<section id="gain">') : page.index('<section id="courses">')
    ]
    assert section.count('<svg viewBox="0 0 720') == 1
    for place in (0, 1):
        assert f'class="line quantity q{place}"' in section


def test_intervals_have_numbers_on_their_axes(page):
    values = page[page.index('<div class="values">') :]
    drawn = values[values.index("<svg") : values.index("</svg>")]
    assert re.findall(r"<text[^>]*>([^<]*)</text>", drawn) == [
        f"{MINUS}0.4",
        f"{MINUS}0.2",
        "0",
    ]


def test_a_size_that_nothing_can_have_is_not_shown():
    given = evidence(500)
    absurd = replace(
        given.screen[0], size=None, standard_error=1.0, cause="setpoint_rate_limit"
    )
    page = render(findings(), replace(given, screen=(absurd,)))
    row = page[page.index("<code>setpoint_rate_limit</code></td>") :].partition(
        "</tr>"
    )[0]
    assert '<td data-head="size alone" class="n"></td>' in row


def test_an_error_that_grows_is_called_larger():
    worse = findings(total_gain={"speed_rpm": gain(1.0, 2.0, 0.4, 0.8)})
    page = render(worse, Evidence())
    assert "2&times; <small>worse, 1.2 to 2.5</small>" in page
    assert (
        str(RatioInWords.of(gain(1.0, 2.0, 0.4, 0.8)))
        == "2 times larger, 95\u00a0% 1.2 to 2.5"
    )
    assert (
        str(RatioInWords.of(gain(3.0, 1.0, 2.0, 4.0)))
        == "3 times smaller, 95\u00a0% 2 to 4"
    )
    assert (
        str(RatioInWords.of(gain(1.0, 1e-14, 9e13, 1.1e14)))
        == "more than 1000 times smaller"
    )
    assert str(RatioInWords.of(gain(1.0, 1.004, 0.9, 1.1))).startswith(
        "unchanged, 95\u00a0% 0.91 to"
    )


@pytest.mark.parametrize(
    "name", [signal.name for signal in robot_table(Ranges(90.0, 1.0, 4.0))]
)
def test_no_headline_names_a_signal(name):
    said = plain(f"In the log {name} has the wrong sign.")
    assert name not in said
    assert "_" not in said


def test_wheels_are_said_together():
    four = ", ".join(f"wheel.{w}.speed_rpm" for w in ("fl", "rl", "fr", "rr"))
    assert plain(f"{four} are held") == "The speeds of the wheels are held"
    assert plain("wheel.fl.duty_pct, wheel.rl.duty_pct and 2 more fit") == (
        "The duties of the wheels fit"
    )
    assert plain("it depends on wheel.rr.speed_rpm, t_s mod 0.5.") == (
        "It depends on the speed of the rear right wheel, a cycle of 0.5 s."
    )


def test_every_cell_says_its_column_for_a_phone(page):
    table = page[page.index('<section id="noise">') :].partition("</table>")[0]
    heads = re.findall(r'<td data-head="([^"]*)"', table)[:5]
    assert heads == ["channel", "white", "correlated", "over", "tails"]


def test_an_error_that_stays_is_not_called_better():
    stays = findings(total_gain={"speed_rpm": gain(0.096, 0.0961, 0.99, 1.0)})
    text = Reader(render(stays, Evidence())).text
    assert "Unchanged: wheel speed." in text
    assert "better" not in text.split("What is wrong")[0]


def test_missing_samples_and_constant_channels_are_drawn():
    given = evidence(1000)
    first = given.series[0]
    gap = first.measured.copy()
    gap[100:200] = np.nan
    flat = replace(
        first, measured=np.ones(1000), simulated=np.ones(1000), extended=None
    )
    page = render(
        findings(), replace(given, series=(replace(first, measured=gap), flat))
    )
    assert "nan" not in page.lower().replace("nano", "")
    assert MINUS in page


def test_the_page_is_the_same_every_time(page):
    assert render(findings(), evidence()) == page


def test_the_page_begins_with_where_the_robot_is_not_with_the_largest_ratio(page):
    text = Reader(page).text
    lede = text[text.index("With the extended model") :].partition("falls")[0]
    assert lede.split()[5:] == ["error", "in", "position", "after", "5", "s"]
    tiles = re.findall(r'<div class="what">([^<]*)</div><div class="ratio">', page)
    assert tiles == [
        "Position after 5\u00a0s",
        "Heading after 5\u00a0s",
        "Wheel speed on average",
    ]


def test_what_is_not_clearly_better_is_not_the_headline():
    unsure = findings(total_gain={
        "position_m": gain(0.3, 0.25, 1.18, 1.22), "gyro_z_rad_s": gain(0.8, 0.1, 6.0, 9.0),
    })  # fmt: skip
    text = Reader(render(unsure, Evidence())).text
    assert "the error in turn rate falls" in " ".join(text.split())
    assert "Error of the turn rate: 0.8" in summary(unsure)
    assert "Error of the position after 5\u00a0s:" in summary(unsure)


def test_a_decision_stands_beside_what_was_found_in_the_end(page):
    section = page[page.index('<section id="selection">') :].partition("</section>")[0]
    assert "Both therefore differ from the single test above" in section
    taken, refused = re.findall(r"<tr>\s*<td.*?</tr>", section, re.DOTALL)
    assert re.findall(r"<td[^>]*>(?:<code>)?([^<]*)", taken)[-2:] == [
        "0.001",
        f"{MINUS}0.47",
    ]
    assert re.findall(r"<td[^>]*>(?:<code>)?([^<]*)", refused)[-2:] == ["", ""]


def test_the_gain_of_a_model_that_nobody_gets_is_not_said():
    given = findings(total_gain={}, model_patch=None, findings=findings().findings[2:3])
    for said in (Reader(render(given, Evidence())).text, summary(given)):
        assert "smaller" not in said
        assert "better" not in said


def test_a_ceiling_is_explained_where_it_stands(page):
    text = Reader(page).text
    assert "regression: 3.9&times;" in page
    assert "the regression fits all measured signals" in text
    assert "flexible" not in text


def test_a_regression_that_reaches_nothing_is_left_out():
    page = render(findings(ceiling={"position_m": 0.39}), Evidence())
    assert "regression: 0.39" not in page
    assert "For comparison, the regression" not in page


def test_without_an_extension_there_is_no_gain():
    given = evidence(500)
    none = {"ratio": 1.0, "ci95": None}
    same = tuple(
        replace(r, gain=r.gain.model_copy(update={"after": r.gain.before, **none}))
        for r in given.gain_by_horizon
    )
    page = render(nothing_found(), replace(given, gain_by_horizon=same))
    assert 'id="gain"' not in page
    assert 'id="sizes"' in page


def test_levels_are_those_of_the_screen(page):
    assert "in at most one in 500 recordings, over all causes" in page
    assert "at most 0.002; the size" in page


def as_halves_show(*halves):
    """Findings of a short log: so many halves of it show each cause."""
    given = findings()
    causes = [f for f in given.findings if f.parameters and f.verdict != "data_fault"]
    same = gain(0.31, 0.31, 0.99, 1.01)
    shown = tuple(
        f.model_copy(update={"halves": n, "gain": {"yaw_rad": same}})
        for f, n in zip(causes, halves, strict=True)
    )
    return given.model_copy(update={"findings": shown, "total_gain": {"yaw_rad": same}})


def test_what_no_half_shows_is_not_called_unchanged():
    """The headline says that it turns less: its gain is not known, which is not none."""
    text = Reader(
        render(as_halves_show(0, 0), Evidence())
        .partition("</head>")[2]
        .removesuffix("</html>")
    ).text
    for said in (text, summary(as_halves_show(0, 0))):
        assert "unchanged" not in said.lower()
        assert "not changed" not in said.lower()
        assert "rotation gain (by neither)" in " ".join(said.split())
    assert "not measured, because neither half" in text


def test_a_gain_that_one_half_lacks_says_so():
    said = " ".join(summary(as_halves_show(1, 2)).split())
    assert "rotation gain (by one alone)" in said
    assert "icr offset" not in said.partition("Not shown by both")[2]
    assert "one half of the recording does not show it" in render(
        as_halves_show(1, 2), Evidence()
    )


def test_a_gain_on_other_logs_leaves_nothing_out():
    there = as_halves_show(0, 0).model_copy(
        update={"notices": (f"{ON_OTHER_LOGS}b.csv",)}
    )
    text = Reader(render(there, Evidence())).text
    assert "by neither" not in text
    assert "Unchanged: heading" in text
