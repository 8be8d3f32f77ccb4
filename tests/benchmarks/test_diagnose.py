"""The campaign: its score, its intervals, and that it goes on where it stopped."""

import argparse
import itertools
import json
import sys
import types
from dataclasses import replace

import pytest
from hilserver_injector import Recipe
from hilserver_injector.cases import CLASSES, Answer, Case, cases

from benchmarks import diagnose, diagnose_results, diagnose_time, diagnose_worker
from benchmarks.binomial import clopper_pearson
from benchmarks.diagnose_scoring import ellipsoid_of, score
from benchmarks.diagnose_table import Row, named_how, rows
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.schema.findings import (
    Detectable,
    Finding,
    Findings,
    Gain,
    Joint,
    Parameter,
)
from hilserver.errors import FailedError


def findings(*made):
    return Findings(
        verdict="findings", logs=(), seed=0, version="", config_sha256="", findings=made
    )


def said(verdict, *causes, regressors=(), **parameters):
    fitted = {
        name: Parameter(value=value, ci95=(low, high), unit="1")
        for name, (value, low, high) in parameters.items()
    }
    return Finding(
        verdict=verdict,
        causes=causes,
        block="drive",
        parameters=fitted,
        regressors=regressors,
    )


def case(**answer):
    return Case("single", "x", Recipe(), Answer(**answer))


HIDDEN = case(causes=(frozenset({"rotation_gain"}),), values={"rotation_gain": -0.03})


@pytest.mark.parametrize(
    ("made", "outcome", "wrong"),
    [
        ([said("named", "rotation_gain")], "right", []),
        ([said("named_group", "rotation_gain", "gyro_scale")], "right", []),
        ([], "missed", []),
        ([said("named", "gyro_scale")], "missed", ["gyro_scale"]),
        (
            [said("named_group", "gyro_scale", "wheel_radius")],
            "missed",
            ["gyro_scale|wheel_radius"],
        ),
        ([said("structure_not_in_library")], "unknown", []),
        (
            [said("named", "rotation_gain"), said("data_fault", "dropouts")],
            "right",
            ["dropouts"],
        ),
        ([said("insufficient_excitation", "gyro_scale")], "missed", []),
        ([said("named_group", "rotation_gain", *"abcde")], "vague", []),
    ],
)
def test_names(made, outcome, wrong):
    result = score(HIDDEN, findings(*made))
    assert (result.outcome, result.wrong) == (outcome, wrong)


def test_values():
    result = score(
        HIDDEN,
        findings(said("named", "rotation_gain", rotation_gain=(-0.02, -0.035, 0))),
    )
    value = result.values["rotation_gain"]
    assert value.in_ci95
    assert not value.within_20


def test_size_counts_from_null():
    """A limit of 55 % is 45 % away from null: 60 % is within a fifth of that, 70 % is not."""
    hidden = case(
        causes=(frozenset({"saturation_limit"}),), values={"saturation_limit": 55.0}
    )
    for fitted, within in ((60.0, True), (70.0, False)):
        made = said("named", "saturation_limit", saturation_limit=(fitted, 50.0, 80.0))
        assert (
            score(hidden, findings(made)).values["saturation_limit"].within_20 is within
        )


def test_the_ellipsoid_knows_what_goes_together():
    """Two scales that grow together: off together they are inside, off against each other not."""
    truth = {"rotation_gain": 0.03, "gyro_scale": 0.04}

    def made(turn, gyro):
        covariance = ((1e-4, 0.99e-4, 0.0), (0.99e-4, 1e-4, 0.0), (0.0, 0.0, 1e-8))
        names = ("rotation_gain", "gyro_scale", "nav_latency")
        return Joint(parameters=names, value=(turn, gyro, 9.0), covariance=covariance)

    assert ellipsoid_of(made(0.045, 0.055), truth).inside
    assert not ellipsoid_of(made(0.045, 0.025), truth).inside
    assert ellipsoid_of(made(0.03, 0.04), {"wheel_radius": 0.02}) is None


def test_the_width_of_one_parameter_is_its_half_interval():
    made = Joint(parameters=("rotation_gain",), value=(0.03,), covariance=((1e-4,),))
    one = ellipsoid_of(made, {"rotation_gain": -0.05})
    assert one.width == pytest.approx(1.645 * 0.01 / 0.05, rel=1e-3)
    assert not one.inside


def test_two_effects():
    pair = case(causes=(frozenset({"rotation_gain"}), frozenset({"gyro_bias"})))
    assert score(pair, findings(said("named", "rotation_gain"))).outcome == "missed"
    both = findings(said("named", "rotation_gain"), said("named", "gyro_bias"))
    assert score(pair, both).outcome == "right"


def test_one_twin_alone_is_a_tossed_coin():
    twins = frozenset({"icr_offset", "nav_lever_arm"})
    twin = case(
        verdict="named_group", causes=(frozenset({"icr_offset"}),), together=twins
    )
    assert score(twin, findings(said("named", "icr_offset"))).outcome == "vague"
    assert score(twin, findings(said("named_group", *twins))).outcome == "right"


def test_outside():
    hidden = case(verdict="structure_not_in_library", regressors=frozenset({"t_s"}))
    structure = said("structure_not_in_library", regressors=("t_s", "nav.x_m"))
    elsewhere = said("structure_not_in_library", regressors=("nav.x_m",))
    named = said("named", "rotation_gain")
    assert score(hidden, findings(structure)).outcome == "right"
    assert score(hidden, findings(elsewhere)).outcome == "vague"
    assert score(hidden, findings(structure, named)).outcome == "vague"
    assert score(hidden, findings(named)).outcome == "missed"


def test_drift_is_more_than_the_name():
    hidden = case(verdict="drift", causes=(frozenset({"gyro_bias"}),))
    assert score(hidden, findings(said("drift", "gyro_bias"))).outcome == "right"
    assert score(hidden, findings(said("named", "gyro_bias"))).outcome == "vague"


def test_intervals():
    assert clopper_pearson(0, 300) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 300)))
    assert clopper_pearson(5, 10) == pytest.approx((0.18709, 0.81291), abs=1e-5)
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert Row("x", 4, 5, least=0.9).verdict == "no"
    assert Row("x", 8, 10, least=0.7, most=0.95).verdict == "yes"
    assert Row("x", 0, 0, least=0.9).verdict == ""


@pytest.mark.parametrize("group", CLASSES)
def test_cases(group):
    made = list(cases(group, range(3)))
    assert len({one.key for one in made}) == len(made)
    for one in made:
        for names in (*one.answer.causes, one.answer.together):
            assert names <= set(CAUSES), one.key


@pytest.fixture
def engine(monkeypatch):
    """Put an engine that always says the same in the place of the real one; returns its calls."""
    calls = []

    def say(log, assembly, *, seed, jobs, progress):
        calls.append(log)
        found = findings(said("named", "gyro_bias"))
        sizes = (Detectable(cause="gyro_bias", size=0.003, unit="rad/s"),)
        evidence = types.SimpleNamespace(extension=())
        return types.SimpleNamespace(
            findings=replace_sizes(found, sizes), evidence=evidence
        )

    def replace_sizes(found, sizes):
        return found.model_copy(update={"smallest_detectable": sizes})

    module = types.ModuleType("hilserver.diagnosis.engine")
    module.diagnose = say
    monkeypatch.setitem(sys.modules, "hilserver.diagnosis.engine", module)
    diagnose_worker._engine.cache_clear()
    yield calls
    diagnose_worker._engine.cache_clear()


FILE = "campaign.jsonl"


def arguments(folder, words=(), **changed):
    parser = argparse.ArgumentParser()
    diagnose.add_arguments(parser)
    args = parser.parse_args(
        ["--jobs", "1", "--duration", "4", "--resume", str(folder / FILE), *words]
    )
    for name, value in changed.items():
        setattr(args, name, value)
    return args


def test_campaign_goes_on_where_it_stopped(tmp_path, engine, capsys):
    args = arguments(
        tmp_path, groups="null,single", only="drive,bench,gyro_bias", seeds=2
    )
    results = {row.name: row for row in diagnose.run(args)}
    assert results["findings without an effect"].raw["count"] == 6
    assert results["right name, single cause"].value == 100.0
    assert len(engine) == 8
    file = tmp_path / FILE
    lines = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(lines[:-1]) + "\n" + lines[-1][:20], encoding="utf-8")
    for _ in range(2):
        diagnose.run(args)
        assert len(engine) == 9, (
            "only the result that was cut short is made again, and once"
        )
    assert "| single | gyro_bias | 2 |" in capsys.readouterr().out


def test_results_of_other_sources_or_lengths_are_not_counted(
    tmp_path, engine, monkeypatch, capsys
):
    args = arguments(tmp_path, groups="single", only="gyro_bias", seeds=1)
    diagnose.run(args)
    with monkeypatch.context() as changed:
        changed.setattr(diagnose_results, "sources", lambda: "another")
        diagnose.run(args)
    args.duration = 5.0
    diagnose.run(args)
    assert len(engine) == 3
    assert (
        "2 results of other sources or settings are not counted"
        in capsys.readouterr().out
    )
    stamps = [
        json.loads(line) for line in (tmp_path / FILE).read_text("utf-8").splitlines()
    ]
    assert [r["setting"] for r in stamps] == ["4 s", "4 s", "5 s"]
    assert stamps[0]["sources"] == diagnose_results.sources() != stamps[1]["sources"]


def test_the_time_without_the_nested_gain_is_all_but_what_that_reports(
    tmp_path, monkeypatch
):
    def engine(log, assembly, *, jobs, progress):
        progress("drive: effect of a", 0.5)
        progress("drive: effect of b", 1.0)
        progress(diagnose_time.HALVES, 0.0)
        progress("measuring the gain", 0.0)

    ticks = itertools.count(0.0, 2.0)
    clock = types.SimpleNamespace(process_time=lambda: next(ticks))
    monkeypatch.setattr(diagnose_time, "time", clock)
    monkeypatch.setattr(diagnose_time, "diagnose", engine)
    monkeypatch.setattr(diagnose_time, "documents", lambda diagnosis: {})
    found = {r.name: r for r in diagnose.run(arguments(tmp_path, ["--time"]))}
    assert len(found) == 6
    assert found["six effects, nested gain"].value == 10.0
    assert found["six effects, without"].value == 8.0
    assert found["no effect, nested gain"].raw["drive"] == 4.0


def test_stopped_campaign_prints_what_it_has(tmp_path, engine, monkeypatch, capsys):
    def work(case):
        if case.recipe.seed == 1:
            raise SystemExit(0)
        return diagnose_worker.work(case)

    monkeypatch.setattr(diagnose, "work", work)
    with pytest.raises(SystemExit):
        diagnose.run(arguments(tmp_path, groups="single", only="gyro_bias", seeds=2))
    said = capsys.readouterr()
    assert "| single | gyro_bias | 1 |" in said.out
    assert f"goes on from {tmp_path / FILE}" in said.err


def test_size_hides_what_the_null_logs_stated(tmp_path, engine):
    with pytest.raises(FailedError, match="null,size"):
        diagnose.run(arguments(tmp_path, groups="size", seeds=1))
    args = arguments(tmp_path, groups="null,size", seeds=1)
    diagnose.run(args)
    file = tmp_path / FILE
    records = [
        json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()
    ]
    sized = [record for record in records if record["group"] == "size"]
    assert [record["name"] for record in sized] == ["gyro_bias"]


@pytest.mark.parametrize(
    ("interval", "patch", "worse"),
    [
        ((0.80, 0.99), True, ["yaw_rad"]),
        ((0.80, 0.99), False, []),
        ((0.80, 1.01), True, []),
        (None, True, []),
    ],
)
def test_no_patch_makes_a_reported_quantity_worse(interval, patch, worse):
    gain = Gain(horizon_s=5.0, before=0.1, after=0.11, ratio=0.9, ci95=interval)
    found = findings().model_copy(update={"total_gain": {"yaw_rad": gain}})
    evidence = types.SimpleNamespace(extension=("a term",) if patch else ())
    diagnosis = types.SimpleNamespace(findings=found, evidence=evidence)
    assert diagnose_worker.made_worse(diagnosis) == worse
    (row,) = (
        r for r in rows([{**HARMLESS, "worse": worse}]) if r.name.startswith("a patch")
    )
    assert row.verdict == ("no" if worse else "yes")


HARMLESS = {"group": "null", "outcome": "right", "wrong": [], "values": {}}


@pytest.fixture
def recorded(tmp_path):
    """Twelve segments of one channel, three a block, each with a value of its own."""
    lines = ["t_s,block,segment,nav.x_m"]
    lines += [f"{0.1 * i:.1f},{s // 3},{s},{s}.0" for s in range(12) for i in range(10)]
    file = tmp_path / "drive.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(
        "time: {column: t_s}\nsegment: {column: segment}\nblock: {column: block}\n"
        "channels: {nav.x_m: {column: nav.x_m}}\n",
        encoding="utf-8",
    )
    return file, mapping


def test_a_drawing_has_whole_blocks_each_once(recorded):
    file, mapping = recorded
    logs = [diagnose_worker.Drawn(str(mapping), file, seed).log() for seed in range(8)]
    for log in logs:
        x = log["nav.x_m"]
        drawn = [x.of(k)[1][0] for k in range(len(log.spans))]
        assert len(drawn) == len(set(drawn)) == 9
        assert {int(s) // 3 for s in drawn} == {span.block for span in log.spans}
        assert all(
            (x.of(k)[1] == s).all() and len(x.of(k)[0]) == 10
            for k, s in enumerate(drawn)
        )
    assert len({tuple(span.number for span in log.spans) for log in logs}) > 1


def test_drawings_of_recordings_are_a_campaign(tmp_path, recorded, engine):
    file, mapping = recorded
    words = ("--recordings", f"{mapping}={file}", "--drawn", "3")
    results = {row.name: row for row in diagnose.run(arguments(tmp_path, words))}
    assert (
        results["a patch makes a quantity worse, all logs"].raw["trials"]
        == len(engine)
        == 3
    )


def test_unknown_class(tmp_path):
    with pytest.raises(FailedError, match="no such class"):
        diagnose.run(arguments(tmp_path, groups="nul"))


def test_changed_logs_keep_their_case():
    one = next(iter(cases("null", range(1))))
    assert diagnose.changed(one, None, False) == one
    assert diagnose.changed(one, 5.0, False).recipe == replace(
        one.recipe, duration_s=5.0
    )
    assert diagnose.changed(one, None, True).recipe.noise.measured_position


def test_ordinary_sensors_have_their_faults_and_nothing_else():
    """Each kind of fault is drawn, some logs have none, and a record says more only of others."""
    made = list(cases("sensors", range(20)))
    hidden = {name for one in made for names in one.answer.causes for name in names}
    assert hidden == {"held_samples", "limited_channel"}
    assert {one.answer.verdict for one in made} == {"data_fault", "nothing_found"}
    held = next(one for one in made if one.recipe.faults)
    for fault, more in (("held_samples", 0), ("dropouts", 1)):
        result = score(held, findings(said("data_fault", fault))).as_json()
        row = rows([{"group": "sensors", **result}])[1]
        assert (row.count, row.trials) == (more, 1)


@pytest.mark.parametrize(
    ("outcome", "missed"), [("right", 0), ("vague", 0), ("missed", 1), ("unknown", 1)]
)
def test_a_hidden_cause_without_a_name_is_missed(outcome, missed):
    record = {
        "group": "single",
        "outcome": outcome,
        "wrong": [],
        "values": {},
        "found": [],
    }
    (row,) = [row for row in rows([record]) if row.name.startswith("missed")]
    assert (row.count, row.trials) == (missed, 1)


@pytest.mark.parametrize(
    ("found", "how"),
    [
        (["named:gyro_bias"], "alone"),
        (["named_group:gyro_bias|gyro_scale"], "group of two"),
        (["named_group:gyro_bias|gyro_scale|rotation_gain"], "larger group"),
        (["named:gyro_bias", "structure_not_in_library:"], "beside another"),
        (["named:gyro_scale"], ""),
    ],
)
def test_how_a_cause_was_named_is_counted(found, how):
    outcome = "right" if how else "missed"
    record = {
        "group": "single",
        "name": "gyro_bias",
        "outcome": outcome,
        "wrong": [],
        "values": {},
    }
    assert named_how(record | {"found": found}) == how
    counted = {row.name: row.count for row in rows([record | {"found": found}])}
    assert sum(counted[name] for name in counted if name.startswith("named ")) == bool(
        how
    )
