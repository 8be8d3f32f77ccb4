"""Diagnoses of the page: why nothing moves, and what is left of earlier ones."""

import asyncio
import errno
import os

import pytest

from hilserver.io.page.hand import RefusedError
from hilserver.io.page.jobs import MAX_KEPT, MAX_WAITING, Jobs, ShareOfTime
from hilserver.io.page.setup import OpcUaAccess, Serving, Setup


async def test_a_diagnosis_that_gets_no_time_says_so():
    """Before, nothing moved for minutes, and nobody said why."""
    idle = await asyncio.create_subprocess_exec("sleep", "60")
    busy = await asyncio.create_subprocess_exec("sh", "-c", "while :; do :; done")
    try:
        shares = {process: ShareOfTime() for process in (idle, busy)}
        waits = {idle: False, busy: False}
        for _ in range(12):
            await asyncio.sleep(0.25)
            waits = {
                p: share.is_small(p.pid, over_s=2.0) for p, share in shares.items()
            }
        assert waits == {idle: True, busy: False}
    finally:
        for process in (idle, busy):
            process.kill()
            await process.wait()


def test_reports_of_earlier_runs_are_there_again(tmp_path):
    """Before, a restart of the daemon left nothing of them on the page."""
    folders = {
        name: str(tmp_path / name) for name in ("reports", "patches", "recordings")
    }
    for minute in (1, 2):
        folder = tmp_path / "reports" / f"turns-20261125-10000{minute}"
        folder.mkdir(parents=True)
        title = f"<title>The robot turns {minute} % more.</title>"
        (folder / "report.html").write_text(title, encoding="utf-8")
    (folder / "model_patch.yaml").write_text("terms: {}\n", encoding="utf-8")
    setup = Setup("", Serving(), OpcUaAccess(), [], {}, [], folders)
    jobs = Jobs(setup)
    newest, older = jobs.view()
    assert (newest["log"], newest["state"]) == (folder.name, "done")
    assert newest["text"] == "The robot turns 2 % more."
    assert sorted(newest["files"]) == ["model_patch.yaml", "report.html"]
    assert jobs.report(folder.name, "report.html") == folder / "report.html"
    assert jobs.keep(newest["number"]) == f"{folder.name}.yaml"
    with pytest.raises(RefusedError, match="no patch"):
        jobs.keep(older["number"])


def test_a_full_disk_is_a_sentence_and_leaves_no_half_file(tmp_path, monkeypatch):
    folders = {
        name: str(tmp_path / name) for name in ("reports", "patches", "recordings")
    }
    folder = tmp_path / "reports" / "turns-20261125-100001"
    for path in (folder, tmp_path / "recordings"):
        path.mkdir(parents=True)
    (folder / "report.html").write_text("<title>It turns.</title>", encoding="utf-8")
    (folder / "model_patch.yaml").write_text("terms: {}\n", encoding="utf-8")
    (tmp_path / "recordings" / "a.csv").write_text("t_s\n", encoding="utf-8")
    jobs = Jobs(Setup("", Serving(), OpcUaAccess(), [], {}, [], folders))

    def refuse(_file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("hilserver.program.whole_file.os.fsync", refuse)
    with pytest.raises(RefusedError, match="cannot be stored: No space left"):
        jobs.keep(1)
    with pytest.raises(RefusedError, match="cannot be stored: No space left"):
        jobs.map("a.csv", "channels: {}")
    assert list((tmp_path / "patches").iterdir()) == []
    assert [path.name for path in (tmp_path / "recordings").iterdir()] == ["a.csv"]


async def test_a_comparison_does_not_wait_for_a_diagnosis(tmp_path, monkeypatch):
    (tmp_path / "recordings").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / "recordings" / name).write_text("t_s\n", encoding="utf-8")
    folders = {name: str(tmp_path / name) for name in ("reports", "recordings")}
    jobs = Jobs(Setup("", Serving(), OpcUaAccess(), [], {}, [], folders))
    worker = tmp_path / "worker"  # a diagnosis lasts; a comparison finds a difference
    worker.write_text('#!/bin/sh\n[ "$3" = compare ] && exit 4\nexec sleep 60\n')
    worker.chmod(0o755)
    monkeypatch.setattr("hilserver.io.page.jobs.sys.executable", str(worker))

    def states():
        return {job["kind"]: job["state"] for job in jobs.view()}

    jobs.diagnose("a.csv")
    jobs.compare("a.csv", "b.csv")
    async with asyncio.timeout(60):
        while states() != {"diagnosis": "running", "comparison": "done"}:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    with pytest.raises(RefusedError, match=r"there is no 'c\.csv'"):
        jobs.compare("a.csv", "c.csv")

    for _ in range(MAX_KEPT + 5):
        number = jobs.compare("a.csv", "b.csv")
        async with asyncio.timeout(60):
            while jobs.view()[0]["state"] != "done":  # noqa: ASYNC110
                await asyncio.sleep(0.01)
    kept = jobs.view()
    assert len(kept) == MAX_KEPT
    assert kept[0]["number"] == number
    assert kept[-1]["state"] == "running"  # the diagnosis is not forgotten
    await jobs.close()


async def test_a_second_diagnosis_waits_for_its_turn(tmp_path, monkeypatch):
    """Before, it was refused: wait or cancel the other."""
    (tmp_path / "recordings").mkdir()
    names = [f"{letter}.csv" for letter in "abc"]
    for name in names:
        (tmp_path / "recordings" / name).write_text("t_s\n", encoding="utf-8")
    folders = {name: str(tmp_path / name) for name in ("reports", "recordings")}
    jobs = Jobs(Setup("", Serving(), OpcUaAccess(), [], {}, [], folders))
    worker, ends = tmp_path / "worker", tmp_path / "ends"
    worker.write_text(f"#!/bin/sh\nuntil [ -e {ends} ]; do sleep 0.01; done\n")
    worker.chmod(0o755)
    monkeypatch.setattr("hilserver.io.page.jobs.sys.executable", str(worker))

    def states():
        return {job["log"]: job["state"] for job in jobs.view()}

    numbers = [jobs.diagnose(name) for name in names]
    await asyncio.sleep(0)
    assert states() == {"a.csv": "running", "b.csv": "waiting", "c.csv": "waiting"}
    jobs.cancel(numbers[1])
    ends.touch()
    async with asyncio.timeout(60):
        while states() != {"a.csv": "done", "c.csv": "done"}:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    ends.unlink()
    for _ in range(MAX_WAITING + 1):
        jobs.diagnose("a.csv")
        await asyncio.sleep(0)
    with pytest.raises(RefusedError, match="10 jobs are waiting: cancel one"):
        jobs.diagnose("a.csv")
    assert len({job["folder"] for job in jobs.view()}) == MAX_WAITING + 3
    await jobs.close()
