"""The file behind the arena: one owner, and nothing left behind by the dead."""

import os
import time

import pytest

from hilserver.errors import FailedError
from hilserver.image.shared_file import SharedFile, map_read_only, path_of, sweep
from hilserver.program.shared_memory import made_up_in_use


def test_an_owned_file_cannot_be_taken_and_is_not_swept():
    name = f"auto-{os.getpid()}-owned"
    owner = SharedFile(name, 4096)
    with pytest.raises(FailedError, match="another hilserver"):
        SharedFile(name, 4096)
    sweep(now_s=time.time() + 1000)
    assert path_of(name).exists()
    assert path_of(name).stat().st_mode & 0o777 == 0o600
    owner.close()
    assert not path_of(name).exists()


def test_what_a_killed_daemon_left_is_swept_when_it_is_old():
    left = path_of(f"auto-{os.getpid()}-left")
    left.write_bytes(b"x" * 4096)
    sweep()
    assert left.exists(), "its owner may be about to lock it"
    assert sweep(now_s=time.time() + 1000) >= 1
    assert not left.exists()


def test_made_up_names_in_use_are_listed():
    used, left = f"auto-{os.getpid()}-used", f"auto-{os.getpid()}-unused"
    owner = SharedFile(used, 4096)
    path_of(left).touch()
    found = made_up_in_use()
    owner.close()
    path_of(left).unlink()
    assert used in found
    assert left not in found


def test_chosen_names_are_not_swept_but_taken_over():
    name = f"chosen-{os.getpid()}"
    path_of(name).write_bytes(b"x" * 10)
    sweep(now_s=time.time() + 1000)
    owner = SharedFile(name, 4096)
    assert path_of(name).stat().st_size == 4096
    owner.close()


@pytest.mark.parametrize("name", ["", "a/b", "a b", "x" * 101])
def test_names_are_plain(name):
    with pytest.raises(FailedError, match="image name"):
        path_of(name)


def test_absent_image():
    with pytest.raises(FailedError, match="is the daemon running"):
        map_read_only("no-such-image")
