"""Files that appear whole or not at all."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hilserver.program.whole_file import whole, write_whole


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    with whole(path) as partial:
        partial.write_text("half")
        assert not path.exists()
        assert not list(tmp_path.glob("*.html")), "nobody takes it for a report"
        partial.write_text("all of it")
    assert path.read_text() == "all of it"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_the_file_of_before_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_whole(path, b"before")

    def break_off() -> None:
        with whole(path) as partial:
            partial.write_text("half")
            raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011 - it has no text
        break_off()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_the_disk_holds_the_new_name_before_it_is_said_to_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[tuple[Path, bool]] = []

    def sync(fd: int) -> None:
        what = Path(f"/proc/self/fd/{fd}").readlink()
        synced.append((what, (tmp_path / "report.html").exists()))

    monkeypatch.setattr(os, "fsync", sync)
    write_whole(tmp_path / "report.html", b"new")
    assert synced[-1] == (tmp_path, True)
    assert [has_name for _, has_name in synced] == [False, True]


def test_a_device_is_written_to_and_a_link_stays_one(tmp_path: Path) -> None:
    target, link, pipe = tmp_path / "target", tmp_path / "link", tmp_path / "pipe"
    target.write_text("old")
    link.symlink_to(target)
    os.mkfifo(pipe)
    with whole(link) as partial:
        partial.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    with whole(pipe) as partial:
        assert partial == pipe
    assert pipe.is_fifo()


def test_a_file_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    for mode in (0o600, 0o664):
        path.touch()
        path.chmod(mode)
        with whole(path) as partial:
            partial.write_text("new")
            assert partial.stat().st_mode & 0o777 == 0o600, (
                "others can read it meanwhile"
            )
        assert (path.read_text(), path.stat().st_mode & 0o777) == ("new", mode)


@pytest.mark.parametrize(
    ("act", "number"),
    [("touch", errno.EACCES), ("touch", errno.EROFS), ("replace", errno.EBUSY)],
)
def test_a_file_that_cannot_be_replaced_is_written_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str, number: int
) -> None:
    """As in a folder that is read-only, and as a file that a container mounts."""

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    path = tmp_path / "report.html"
    path.write_text("before, and longer")
    node = path.stat().st_ino
    monkeypatch.setattr(Path, act, refuse)
    write_whole(path, b"new")
    assert (path.read_text(), path.stat().st_ino) == ("new", node)
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_no_reason_to_write_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "report.html"
    path.write_text("before")
    monkeypatch.setattr(Path, "touch", refuse)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, b"new")
    assert path.read_text() == "before"


def test_the_output_of_a_program_is_not_replaced_where_it_is_a_file(
    tmp_path: Path,
) -> None:
    path = tmp_path / "said"
    write = "from hilserver.program.whole_file import *; write_whole(Path('/dev/stdout'), b'new')"
    with path.open("wb") as output:
        subprocess.run([sys.executable, "-c", write], stdout=output, check=True)
        assert path.stat().st_ino == os.fstat(output.fileno()).st_ino
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
