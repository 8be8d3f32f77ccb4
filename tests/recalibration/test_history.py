"""The history: whole lines or none, a chain that shows what was changed, half a line cut off."""

import json
import os
import re
from pathlib import Path

import hypothesis
import pytest
from hypothesis import strategies as st

from hilserver.errors import FailedError
from hilserver.recalibration import judging, loop
from hilserver.recalibration.history import FILE, History, broken, is_sound


def lines_of(folder):
    return [json.loads(text) for text in (folder / FILE).read_text().splitlines()]


def filled(folder, n=3):
    history = History(folder)
    for k in range(n):
        history.append("look", window=k, verdict="nothing")
    return history


def test_lines_are_numbered_and_chained(tmp_path):
    filled(tmp_path)
    lines = lines_of(tmp_path)
    assert [line["number"] for line in lines] == [1, 2, 3]
    assert broken(lines) is None


@pytest.mark.parametrize("change", ["value", "removed", "order"])
def test_what_was_changed_shows(tmp_path, change):
    filled(tmp_path)
    lines = lines_of(tmp_path)
    if change == "value":
        lines[1]["verdict"] = "named"
    elif change == "removed":
        del lines[1]
    else:
        lines[0], lines[1] = lines[1], lines[0]
    assert broken(lines) in (1, 2)


def test_a_line_with_a_number_that_none_is_written_with_does_not_count(tmp_path):
    (tmp_path / FILE).write_text('{"kind": "look", "p": 1e999, "hash": "x"}\n')
    (line,) = History(tmp_path).lines
    assert not is_sound(line)
    assert broken([line]) == 1


@hypothesis.given(cut=st.integers(1, 60))
def test_half_a_line_is_cut_off_and_the_chain_goes_on(tmp_path_factory, cut):
    folder = tmp_path_factory.mktemp("history")
    filled(folder)
    content = (folder / FILE).read_bytes()
    (folder / FILE).write_bytes(content[:-cut])
    History(folder).append("look", window=9)
    lines = lines_of(folder)
    assert [line["window"] for line in lines] == [0, 1, 9]
    assert broken(lines) is None


def test_a_damaged_line_within_is_no_reason_to_write_over_it(tmp_path):
    filled(tmp_path)
    rows = (tmp_path / FILE).read_text().splitlines()
    (tmp_path / FILE).write_text("\n".join([rows[0], "{", rows[2]]) + "\n")
    with pytest.raises(FailedError, match=r"line 2 is damaged; move the file away"):
        History(tmp_path)


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path, monkeypatch):
    history = filled(tmp_path)
    before = (tmp_path / FILE).read_bytes()
    monkeypatch.setattr("os.write", lambda fd, data: 0)
    with pytest.raises(
        FailedError, match=r"recalibration\.jsonl: cannot be written: no space"
    ):
        history.append("look", window=4)
    monkeypatch.undo()
    assert (tmp_path / FILE).read_bytes() == before
    history.append("look", window=5)
    assert broken(lines_of(tmp_path)) is None


def test_the_disk_holds_the_name_of_a_new_history(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(
        os, "fsync", lambda fd: synced.append(Path(f"/proc/self/fd/{fd}").readlink())
    )
    filled(tmp_path)
    file = tmp_path / FILE
    assert synced == [file, tmp_path, file, file]


def test_every_verdict_stands_in_the_reference_and_has_words_on_the_page():
    root = Path(__file__).parents[2]
    reference = (root / "docs" / "reference" / "recalibration.md").read_text(
        encoding="utf-8"
    )
    page = (root / "page" / "src" / "views" / "proposal.ts").read_text(encoding="utf-8")
    rooms = (loop.__file__, judging.__file__)
    source = "".join(Path(file).read_text(encoding="utf-8") for file in rooms)
    made = set(re.findall(r'(?:Looked\(\s*|"verdict": | else )"(\w+)"', source))
    said = set(re.findall(r"^\| `(\w+)` \| .* \| ", reference, re.MULTILINE))
    assert {"too_small", "no_test", "too_short", "nothing", "better"} < made <= said
    assert [one for one in sorted(said) if f"\n  {one}: " not in page] == []
