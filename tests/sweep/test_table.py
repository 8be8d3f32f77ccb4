"""Results on disk and back, report, JUnit and comparison, of sweeps that were driven here."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest

from hilserver.errors import FailedError, LogError
from hilserver.sweep import table as module
from hilserver.sweep.batch import fingerprint
from hilserver.sweep.journal import SweepJournal
from hilserver.sweep.junit import write_junit
from hilserver.sweep.report.page import write_report
from hilserver.sweep.rig import MachineOutcome, Rig
from hilserver.sweep.table import read_table, table_of, write_table
from hilserver.sweep.words import compare

WIDE = {"from": {"population": {"coulomb_friction": {"mean": 1, "sd": 1}}}}


def swept(prepared, folder, machines=None):
    """Drive all machines in this process; return the table."""
    rig = Rig(prepared.job)
    journal = SweepJournal(folder, prepared.job.key, resume=True)
    n = prepared.sweep.machines if machines is None else machines
    left = [index for index in range(n) if index not in journal.done]
    journal.add([rig.drive(prepared.machine(index)) for index in left], fingerprint())
    journal.close()
    return table_of(prepared, journal, range(n))


def same(a, b):
    for one, other in zip(a.columns().items(), b.columns().items(), strict=True):
        assert one[0] == other[0]
        assert np.asarray(one[1]).tobytes() == np.asarray(other[1]).tobytes()


def test_a_table_comes_back_to_the_bit(made, tmp_path):
    table = swept(made(machines=20, **WIDE), tmp_path / "out")
    assert table.count("refused") > 0
    assert write_table(tmp_path / "out", table).suffix == ".parquet"
    same(read_table(tmp_path / "out"), table)


def test_without_pyarrow_it_is_csv(made, tmp_path, monkeypatch):
    table = swept(made(machines=8, **WIDE), tmp_path / "out")
    monkeypatch.setattr(module, "find_spec", lambda _: None)
    assert write_table(tmp_path / "out", table).suffix == ".csv"
    again = read_table(tmp_path / "out")
    assert again.status == table.status
    for name, values in table.margins.items():
        assert again.margins[name].tobytes() == values.tobytes()


def test_a_folder_without_a_sweep(tmp_path):
    with pytest.raises(LogError, match="contains no finished sweep"):
        read_table(tmp_path)


def test_a_journal_is_continued_after_a_torn_line(made, tmp_path):
    prepared, out = made(), tmp_path / "out"
    whole = swept(prepared, tmp_path / "whole")
    swept(prepared, out, machines=4)
    content = (out / "finished.jsonl").read_bytes()
    # killed while it wrote machine 3
    (out / "finished.jsonl").write_bytes(content[:-7])
    same(swept(prepared, out), whole)
    assert len((out / "finished.jsonl").read_bytes().splitlines()) == 1 + 6


def test_another_sweep_is_not_continued(made, tmp_path):
    swept(made(), tmp_path / "out", machines=1)
    with pytest.raises(FailedError, match="belongs to another sweep"):
        swept(made(seed=8), tmp_path / "out")
    with pytest.raises(FailedError, match="continue with --resume"):
        SweepJournal(tmp_path / "out", made().job.key, resume=False)


def test_the_truth_is_in_the_report(made, limit, tmp_path):
    table = swept(made(machines=400, **limit), tmp_path / "out")
    a, b = (table.parameters[f"blocks.limit.{name}"] for name in "ab")
    assert np.array_equal(np.array(table.status) == "passed", a - 2.0 * b >= 0.0)
    page = write_report(tmp_path / "out", table).read_text()
    order = [page.index(f"<code>blocks.limit.{name}</code>") for name in "bac"]
    assert order == sorted(order)
    share = np.mean(np.array(table.status) == "passed")
    assert f"{100 * share:.1f} %" in page
    assert "The machines are a population" in page
    assert "Where &#39;limit&#39; fails" in page
    worst = table.index[np.argmin(a - 2.0 * b)]
    assert f'data-head="machine" class="n">{worst}</td>' in page


def test_a_fault_that_decides_has_no_axis(made, tmp_path):
    fault = {"fault": "bias", "signal": "pose.y_m", "offset": 0.5}
    table = swept(
        made(machines=40, faults=[{"share": 0.5, "fault": fault}]), tmp_path / "out"
    )
    page = write_report(tmp_path / "out", table).read_text()
    assert page.index("<code>bias:pose.y_m</code>") < page.index(
        "<code>terms.rotation_gain</code>"
    )
    assert "Where &#39;straight&#39; fails" in page


def test_the_report_of_failures_alone(made, tmp_path):
    table = swept(made(machines=8, **WIDE), tmp_path / "out")
    none = table.margins["straight"] * np.nan
    broken = module.MachineTable(
        *(getattr(table, name) for name in ("index", "seed", "parameters", "faults")),
        {"straight": none, "arrives": none},
        ["error" if s != "refused" else s for s in table.status],
        ["took longer than 1 s" if s != "refused" else m for s, m in _said(table)],
        table.computer,
        table.about,
    )
    page = write_report(tmp_path / "out", broken).read_text()
    assert "Where the controller failed" in page
    assert "Draws outside the range of a parameter" in page


def _said(table):
    return zip(table.status, table.message, strict=True)


def test_junit_fails_where_too_few_machines_meet_a_requirement(made, limit, tmp_path):
    half = limit["require"][0] | {"name": "half", "share": 0.3}
    require = [*limit["require"], half]
    table = swept(made(machines=40, **(limit | {"require": require})), tmp_path / "out")
    write_junit(tmp_path / "j.xml", table)
    suite = ET.parse(tmp_path / "j.xml").getroot()
    assert suite.attrib["tests"] == "2"
    assert suite.attrib["failures"] == "1"
    failed = suite.find("testcase/failure")
    worst = table.index[np.argmin(table.margins["limit"])]
    assert failed.text.startswith(f"machine {worst}: margin -")


def test_two_controllers_on_the_same_machines(made, limit, tmp_path):
    stricter = limit["require"][0] | {"above": 0.5}
    a = swept(made(machines=60, **limit), tmp_path / "a")
    b = swept(made(machines=60, **(limit | {"require": [stricter]})), tmp_path / "b")
    text = compare(a, b)
    assert "60 machines, the same in both" in text
    only_a = a.count("passed") - b.count("passed")
    assert f"only in A {only_a}, only in B 0" in text
    assert "margin in B minus A, median -0.5 (-0.5 .. -0.5)" in text
    with pytest.raises(LogError, match="different machines"):
        compare(a, swept(made(machines=60, seed=8, **limit), tmp_path / "c"))


def test_an_outcome_passes_with_margins_that_are_not_negative():
    assert MachineOutcome(0, (0.0, 1.0)).passed
    assert not MachineOutcome(0, (-1e-9, 1.0)).passed
    assert not MachineOutcome(0, error="took longer").passed
