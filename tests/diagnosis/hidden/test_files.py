"""`hilserver diagnose` with the real engine: from files of the injector to files of findings."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hilserver_injector import Table, make

from hilserver.commands import main
from hilserver.config.patch import load_patch
from hilserver.config.section import schema_text
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.schema.findings import Findings
from tests.diagnosis.assertions import (
    nothing_is_found,
    the_cause_is_named,
    the_value_is_right,
)
from tests.diagnosis.hidden.logs import recipe

FRICTION = ("coulomb_friction", 2, 6.0)
NOTHING = ("nothing bench", 5, 5.0)


def written(folder, name, *log, **changes):
    path = folder / name
    make(replace(recipe(*log), **changes))[0].write_csv(path)
    return str(path)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return [
        written(folder, "friction.csv", *FRICTION),
        written(folder, "sound.csv", *NOTHING),
    ]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(folder):
    """The findings of a folder, checked against their schema."""
    data = json.loads((folder / "findings.json").read_text(encoding="utf-8"))
    jsonschema.validate(data, json.loads(schema_text(Findings)))
    return Findings.model_validate(data)


def test_a_log_with_an_effect(logs, folder, capsys):
    assert main(["diagnose", logs[0], "-o", "out"]) == 0
    found = read(folder / "out")
    the_cause_is_named(found, "coulomb_friction")
    the_value_is_right(found, "coulomb_friction", 1.5)
    (source,) = found.logs
    assert source.sha256 == hashlib.sha256(Path(logs[0]).read_bytes()).hexdigest()
    patch = load_patch(folder / "out" / "model_patch.yaml").model
    assert patch.terms["coulomb_friction"].value == pytest.approx(
        found.findings[0].parameters["coulomb_friction"].value
    )
    assert patch.made_from.config_sha256 == assemble(None).config.sha256
    assert patch.terms["coulomb_friction"].fitted_in.wheel_speed_rpm is not None
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "coulomb" in page.lower()
    assert "<svg" in page
    assert "report.html" in capsys.readouterr().out


def test_a_log_without_an_effect_and_without_a_patch(logs, folder):
    assert main(["diagnose", logs[1], "-o", "out"]) == 0
    nothing_is_found(read(folder / "out"))
    assert {p.name for p in (folder / "out").iterdir()} == {
        "findings.json",
        "report.html",
    }


def test_a_log_that_cannot_be_read_is_one_sentence_and_exit_2(folder, capsys):
    (folder / "bad.csv").write_text("t_s,wheel.fl.speed_rpm\n0.0,1.0\n0.1,fast\n")
    assert main(["diagnose", "bad.csv", "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "bad.csv" in line
    assert not (folder / "out").exists()


def each(logs, out, *words):
    assert main(["diagnose", *logs, "--each", *words, "-o", str(out)]) == 0
    return {
        name: (out / name / "findings.json").read_text(encoding="utf-8")
        for name in ("friction", "sound")
    }


def test_each_log_alone_whoever_does_the_work(logs, folder):
    alone = each(logs, folder / "one", "--jobs", "1")
    the_cause_is_named(read(folder / "one" / "friction"), "coulomb_friction")
    nothing_is_found(read(folder / "one" / "sound"))
    assert each(logs, folder / "two", "--jobs", "2") == alone


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")  # of the cluster's own making
def test_each_log_alone_on_a_cluster(logs, folder):
    """In every run `test_many.py` asks a cluster for other work."""
    alone = each(logs, folder / "one", "--jobs", "1")
    distributed = pytest.importorskip("distributed")
    options = {
        "n_workers": 1,
        "threads_per_worker": 1,
        "dashboard_address": "127.0.0.1:0",
    }
    with distributed.LocalCluster(processes=False, **options) as cluster:
        found = each(logs, folder / "dask", "--dask", cluster.scheduler_address)
    for name, text in found.items():
        assert json.loads(text) == json.loads(alone[name]), name


# --- two sets -------------------------------------------------------------------------------------


def half(table, second):
    middle = len(table.t_s) // 2
    part = slice(middle, None) if second else slice(0, middle)
    return Table(table.t_s[part], {k: v[part] for k, v in table.columns.items()})


def compared(folder, a, b):
    words = ["--compare", str(a), "--against", str(b), "-o", "out"]
    assert main(["diagnose", *words]) == 0
    return read(folder / "out")


def test_two_halves_of_one_recording_do_not_differ(folder):
    whole = make(recipe("rotation_gain", 4, 160.0))[0]
    for name, second in (("a.csv", False), ("b.csv", True)):
        half(whole, second).write_csv(folder / name)
    found = compared(folder, "a.csv", "b.csv")
    assert found.verdict == "no_difference"
    assert found.findings == ()
    sizes = {d.cause: d.size for d in found.smallest_detectable}
    assert 0.0 < sizes["rotation_gain"] < 0.1, (
        "a difference of this size would have been seen"
    )


def test_worn_tyres_are_seen_between_two_days(folder):
    a = written(folder, "a.csv", "nothing drive", 6, 150.0)
    b = written(
        folder, "b.csv", "nothing drive", 7, 150.0, causes={"wheel_radius": -0.04}
    )
    found = compared(folder, a, b)
    assert found.verdict == "differs"
    assert found.findings
    names = set().union(*(set(f.causes) for f in found.findings))
    assert "wheel_radius" in names, names
    (finding,) = (f for f in found.findings if "wheel_radius" in f.causes)
    change = finding.parameters["wheel_radius"]
    low, high = change.ci95
    assert low <= -0.04 <= high
    assert high < 0.0
    assert np.isclose(
        change.value,
        finding.parameters["wheel_radius.b"].value
        - finding.parameters["wheel_radius.a"].value,
    )
    assert abs(finding.parameters["wheel_radius.a"].value) < 0.01


def test_the_answer_for_ros_2_starts_from_its_own_file_and_patches_it(logs, folder):
    """The injector's robot has K_om 0.31/(0.25**2 + 0.31**2); its drive alone is judged here."""
    own = (
        "wheel_separation: 0.31, wheel_radius: 0.085, wheel_separation_multiplier: 1.65"
    )
    (folder / "own.yaml").write_text(f"base: {{ros__parameters: {{{own}}}}}")
    words = [
        "diagnose",
        logs[0],
        "--robot",
        "own.yaml",
        "--for",
        "ros2_control,simulink",
    ]
    assert main([*words, "-o", "out"]) == 0

    text = (folder / "out/for/ros2_control/real_robot.yaml").read_text()
    assert "no place for it: coulomb_friction" in text
    assert "wheel_separation_multiplier: 1.65" in text
    script = (folder / "out/for/simulink/robot_parameters.m").read_text()
    friction = float(
        script.partition("coulomb_friction = ")[2].split(";")[0].split()[0]
    )
    patch = load_patch(folder / "out/model_patch.yaml")
    assert friction == pytest.approx(patch.values["terms.coulomb_friction"], rel=1e-5)
    configured = assemble(
        folder / "out/for/config.yaml", folder / "out/model_patch.yaml"
    )
    assert configured.robot.k_om == pytest.approx(1.0 / (0.31 * 1.65))
    assert patch.notice(configured.config.sha256) is None
