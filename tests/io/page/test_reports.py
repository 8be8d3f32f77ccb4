"""Reports on disk are listed by what their title says, whatever else lies beside them."""

import os

from hilserver.io.page.files import reports_in, shown_report

TITLE = "<!doctype html>\n<html><head><title>{}</title></head></html>"


def report(folder, name, title, modified_s):
    (folder / name).mkdir()
    path = folder / name / "report.html"
    path.write_text(TITLE.format(title), encoding="utf-8")
    os.utime(path, (modified_s, modified_s))
    return path


def test_reports_are_listed_newest_first_with_what_they_say(tmp_path):
    report(tmp_path, "old", "144 of 300 machines pass: 48.0 %", 1000)
    report(tmp_path, "new", "wheels &lt; 2 &amp; more", 2000)
    found = list(reports_in(tmp_path))
    assert [(row["name"], row["title"]) for row in found] == [
        ("new", "wheels < 2 & more"),
        ("old", "144 of 300 machines pass: 48.0 %"),
    ]
    assert [row["modified_s"] for row in found] == [2000, 1000]


def test_a_sweep_that_goes_on_is_listed_without_a_report(tmp_path):
    """Before it ends, its folder holds nothing but what is finished."""
    (tmp_path / "running").mkdir()
    (tmp_path / "running" / "finished.jsonl").write_text("{}\n", encoding="utf-8")
    (row,) = reports_in(tmp_path)
    assert (row["name"], row["title"]) == ("running", None)
    assert shown_report(tmp_path, "running") is None


def test_what_is_no_report_is_left_out(tmp_path):
    report(tmp_path, ".hidden", "hidden", 1)
    report(tmp_path, "a b", "a name with a space", 1)
    (tmp_path / "empty").mkdir()
    (tmp_path / "report.html").write_text(TITLE.format("no folder"), encoding="utf-8")
    (tmp_path / "binary").mkdir()
    (tmp_path / "binary" / "report.html").write_bytes(b"\xff" * 10_000)
    assert [(row["name"], row["title"]) for row in reports_in(tmp_path)] == [
        ("binary", "")
    ]
    assert list(reports_in(tmp_path / "absent")) == []


def test_a_report_is_found_by_a_plain_name_only(tmp_path):
    path = report(tmp_path, "friction", "it", 1)
    inner = tmp_path / "inner"
    inner.mkdir()
    assert shown_report(tmp_path, "friction") == path
    for name in ("..", "../friction", "", ".", "friction/", "absent"):
        assert shown_report(inner, name) is None, name
        assert name == "absent" or shown_report(tmp_path, name) is None, name
