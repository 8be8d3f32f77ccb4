"""Files that appear whole or not at all."""

from pathlib import Path

import pytest

from hilserver.program.whole_file import whole, write_whole


def test_a_file_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    with whole(path) as partial:
        partial.write_text("half")
        assert not path.exists()
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
