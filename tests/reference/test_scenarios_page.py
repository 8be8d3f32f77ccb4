"""The page of the scenarios: complete, legible, and made anew by one command."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import hilserver
from hilserver.commands import main
from hilserver.diagnosis.schema.findings import Finding, Findings, Parameter
from hilserver.scenarios import SCENARIOS
from reference.scenarios.page import PAGE, PLOTS, sections
from reference.scenarios.telling import COLUMNS, hidden_value, section, words
from reference.scenarios.views import VIEWS

DOCS = Path(__file__).parents[2] / "docs" / "explanation"
SVG = "{http://www.w3.org/2000/svg}"
LARGEST_BYTES, MOST_POINTS = 60_000, 601


def findings(*told, verdict="findings"):
    return Findings(
        verdict=verdict,
        logs=(),
        seed=0,
        version="",
        config_sha256="",
        findings=tuple(told),
    )


def named(cause, value, ci95, verdict="named"):
    parameter = Parameter(value=value, ci95=ci95, unit="1")
    return Finding(
        verdict=verdict, causes=(cause,), block="drive", parameters={cause: parameter}
    )


def test_words_and_views_are_those_of_the_list():
    assert list(words()) == list(SCENARIOS)
    assert list(VIEWS) == list(SCENARIOS)


def test_page_and_list_agree():
    found = sections((DOCS / PAGE).read_text(encoding="utf-8"))
    assert list(found) == list(SCENARIOS)
    for name, text in found.items():
        assert f"]({PLOTS}/{name}.svg)" in text
        running = " ".join(text.split())
        assert words()[name].happens in running
        assert words()[name].do in running
        assert "**Hidden:**" in text
        assert "**The diagnosis says:**" in text
    assert {p.stem for p in (DOCS / PLOTS).iterdir()} == set(SCENARIOS)


@pytest.mark.parametrize("name", SCENARIOS)
def test_plot_is_legible(name):
    file = DOCS / PLOTS / f"{name}.svg"
    assert file.stat().st_size < LARGEST_BYTES
    picture = ElementTree.fromstring(file.read_text(encoding="utf-8"))
    texts = {role: [] for role in ("heading", "axis-label")}
    for text in picture.iter(f"{SVG}text"):
        if text.get("class") in texts:
            texts[text.get("class")].append(text.text or "")
    assert texts["heading"] == [words()[name].title]
    labels = [label for label in texts["axis-label"] if label]
    assert len(labels) >= 2
    assert all(label.endswith("]") or label == "run" for label in labels)
    assert "prefers-color-scheme: dark" in picture.find(f"{SVG}style").text
    lines = [
        p.get("d") for p in picture.iter(f"{SVG}path") if "line " in p.get("class")
    ]
    assert max(len(re.findall("[ML]", d)) for d in lines) <= MOST_POINTS


def test_one_section_is_made_and_the_others_stay(tmp_path, capsys):
    (tmp_path / PAGE).write_text(
        "# Old\n\n## `radio`\n\nkept\n\n## `fast_input`\n\nold\n"
    )
    assert main(["scenarios", "page", "fast_input", "-o", str(tmp_path)]) == 0
    found = sections((tmp_path / PAGE).read_text(encoding="utf-8"))
    assert list(found) == ["fast_input", "radio"], "in the order of the list"
    assert found["radio"].endswith("kept\n")
    assert "`data_fault`: `setpoint_as_measurement`." in found["fast_input"]
    assert "Not as it should be" not in found["fast_input"]
    plot = (tmp_path / PLOTS / "fast_input.svg").read_text(encoding="utf-8")
    assert 'class="line measured"' in plot
    assert 'class="line simulated"' in plot
    assert PAGE in capsys.readouterr().out


def test_folder_that_is_a_file(tmp_path, capsys):
    (tmp_path / "taken").write_text("")
    assert main(["scenarios", "page", "fast_input", "-o", str(tmp_path / "taken")]) == 1
    assert "choose another folder with -o" in capsys.readouterr().err


def test_values_stand_beside_the_truth():
    one = SCENARIOS["unsteady_bias"]
    right = named("imu_latency", 0.0752, (0.0741, 0.0763))
    text = section(one, one.draw(0), findings(right), "plot.svg")
    assert "| `imu_latency` | 0.0752 | 0.0741 to 0.0763 | 0.075 |" in text
    assert "Not as it should be" not in text


def test_a_wrong_diagnosis_is_not_hidden():
    one = SCENARIOS["unsteady_bias"]
    wrong = named("rotation_gain", -0.1, (-0.2, -0.05))
    text = section(one, one.draw(0), findings(wrong), "plot.svg")
    assert "**Not as it should be:** no finding of imu_latency" in text
    assert max(map(len, text.splitlines())) <= COLUMNS
    assert "rotation_gain was not hidden" in " ".join(text.split())


def test_truth_of_a_comparison_is_that_of_both_sides():
    drive = SCENARIOS["on_a_frame"].draw(0)
    told = named("viscous_load", 0.08, (0.07, 0.09), "differs")
    values = [
        hidden_value(n, told, drive)
        for n in ("viscous_load.a", "viscous_load.b", "viscous_load")
    ]
    assert values == [0.0, 0.08, 0.08]
    assert hidden_value("dead_zone.b", told, drive) is None


def test_what_is_installed_says_where_the_page_is_written(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(
        hilserver, "__file__", str(tmp_path / "hilserver" / "__init__.py")
    )
    assert main(["scenarios", "page", "-o", str(tmp_path)]) == 1
    assert "run it in a checkout" in capsys.readouterr().err
