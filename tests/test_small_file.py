"""Small files that a user names: what is none is refused in words, and nobody waits for it."""

import os

import pytest

from hilserver.small_file import LARGEST, read_small


def test_a_file_is_read_whole(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"a" * LARGEST)
    assert len(read_small(path)) == LARGEST


def test_a_larger_one_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"abcd")
    with pytest.raises(OSError, match="larger than 3 bytes"):
        read_small(path, 3)


@pytest.mark.parametrize("what", ["pipe", "device", "folder", "loop"])
def test_what_is_no_file_is_refused_at_once(tmp_path, what):
    path = tmp_path / "file"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero" if what == "device" else path)
    with pytest.raises(OSError, match=r"not a regular file|directory|symbolic links"):
        read_small(path)
