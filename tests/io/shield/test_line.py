"""The line: a pseudo-terminal with a link, a device that exists, and nothing else."""

import os
import termios

import pytest

from hilserver.errors import FailedError
from hilserver.io.shield.line import open_device, open_pseudo_terminal


def test_a_pseudo_terminal_is_a_raw_line_behind_a_link(tmp_path):
    line = open_pseudo_terminal(tmp_path / "runtime" / "shield")
    host = os.open(line.link, os.O_RDWR | os.O_NOCTTY)
    settings = termios.tcgetattr(host)
    assert not settings[3] & (termios.ECHO | termios.ICANON)
    assert settings[4] == settings[5] == termios.B115200
    os.write(host, b"\xff\x11\x0d")
    assert os.read(line.file, 10) == b"\xff\x11\x0d"
    os.write(line.file, b"\x03\x0a")
    assert os.read(host, 10) == b"\x03\x0a"
    os.close(host)
    line.close()
    assert list((tmp_path / "runtime").iterdir()) == []


def test_a_stale_link_is_replaced_and_that_of_another_left(tmp_path):
    link = tmp_path / "shield"
    link.symlink_to("/nonexistent")
    first = open_pseudo_terminal(link)
    second = open_pseudo_terminal(link)
    first.close()
    assert link.readlink() == second.path
    second.close()


def test_a_file_is_never_replaced_by_a_link(tmp_path):
    (tmp_path / "shield").write_text("mine")
    with pytest.raises(
        FailedError, match="exists and is not a link; choose another path"
    ):
        open_pseudo_terminal(tmp_path / "shield")
    assert (tmp_path / "shield").read_text() == "mine"


def test_a_link_in_a_place_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FailedError, match="cannot make"):
        open_pseudo_terminal(tmp_path / "file" / "shield")


def test_a_mistyped_device_is_a_sentence_and_no_new_file(tmp_path):
    with pytest.raises(FailedError, match=r"there is no .*ttyS99; name a serial line"):
        open_device(tmp_path / "ttyS99")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_line_is_refused(tmp_path):
    (tmp_path / "file").write_text("text")
    for path in (tmp_path / "file", "/dev/null"):
        with pytest.raises(FailedError, match="is not a serial line"):
            open_device(path)
    assert (tmp_path / "file").read_text() == "text"
