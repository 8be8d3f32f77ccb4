"""The file behind the arena: what the system refuses is one sentence, never a crash later on."""

import fcntl
import os
from contextlib import closing
from pathlib import Path

import pytest

from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.image.shared_file import SharedFile, map_read_only, path_of
from tests.fakes import image_name

N_BYTES = 4096


@pytest.fixture
def name():
    name = image_name()
    yield name
    path = path_of(name)
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def test_a_file_left_behind_is_replaced(name):
    path_of(name).write_bytes(b"\xff" * 3 * N_BYTES)
    with closing(SharedFile(name, N_BYTES)) as file:
        assert file.map[:] == bytes(N_BYTES)
        assert path_of(name).stat().st_mode & 0o777 == 0o600
    assert not path_of(name).exists()


def test_a_second_owner_is_refused(name):
    with (
        closing(SharedFile(name, N_BYTES)),
        pytest.raises(FailedError, match=f"image '{name}'"),
    ):
        SharedFile(name, N_BYTES)


def test_a_folder_or_a_link_in_its_place_is_named(name, tmp_path):
    path_of(name).mkdir()
    with pytest.raises(FailedError, match=f"hilserver-{name}.*directory"):
        SharedFile(name, N_BYTES)
    path_of(name).rmdir()
    path_of(name).symlink_to(tmp_path / "victim")
    with pytest.raises(FailedError, match=f"hilserver-{name}"):
        SharedFile(name, N_BYTES)
    assert not (tmp_path / "victim").exists()


def test_too_little_shared_memory_is_told_before_the_first_write(name):
    with pytest.raises(
        FailedError, match=r"1099512 MB.*no space left.*image\.ring_frames"
    ):
        SharedFile(name, 2**40)
    assert not path_of(name).exists()


def test_a_file_removed_by_its_last_owner_meanwhile_is_made_anew(name, monkeypatch):
    lock, calls = fcntl.flock, []

    def late(fd, operation):
        if Path(f"/proc/self/fd/{fd}").readlink() == path_of(
            name
        ):  # not what the sweep looks at
            calls.append(fd)
            if len(calls) == 1:
                path_of(name).unlink()
        lock(fd, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with closing(SharedFile(name, N_BYTES)) as file:
        assert path_of(name).stat().st_size == len(file.map)
    assert len(calls) == 2


@pytest.mark.parametrize("content", [b"", b"HILS"])
def test_an_image_that_is_not_complete_yet_is_told(name, content):
    path_of(name).write_bytes(content)
    with pytest.raises(FailedError, match=f"process image '{name}'"):
        ImageReader.attach(name)


def test_a_file_of_another_user_is_neither_adopted_nor_removed(name, monkeypatch):
    """Its owner could read, write and shrink the daemon's memory."""
    path_of(name).write_bytes(b"theirs")
    path_of(name).chmod(0o666)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(
        FailedError, match=rf"{name}: belongs to another user \(id \d+\).*image"
    ):
        SharedFile(name, N_BYTES)
    assert path_of(name).read_bytes() == b"theirs"


def test_who_had_a_leftover_open_does_not_see_the_daemon_in_it(name):
    with (
        path_of(name).open("w+b") as theirs,
        closing(SharedFile(name, N_BYTES)) as file,
    ):
        file.map[:5] = b"robot"
        assert theirs.read() == b""


def test_a_pipe_in_its_place_is_named_and_nothing_waits(name):
    os.mkfifo(path_of(name))
    with pytest.raises(FailedError, match=f"hilserver-{name}: is not a regular file"):
        SharedFile(name, N_BYTES)
    with pytest.raises(FailedError, match="not complete"):
        map_read_only(name)


def test_an_image_of_another_user_is_not_read(name, monkeypatch):
    path_of(name).write_bytes(bytes(N_BYTES))
    os.chown(path_of(name), os.getuid(), os.getgid())
    if os.getuid() == 0:
        os.chown(path_of(name), 65534, 65534)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    with pytest.raises(FailedError, match="belongs to user"):
        map_read_only(name)
