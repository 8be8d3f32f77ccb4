"""A picture of a computer that had no time would show figures that are nobody's."""

import pytest

from tests.page import pictures


class Page:
    """Answers as a browser does whose plant is late for the first `late` looks."""

    def __init__(self, late):
        self.late, self.saved = late, []

    def do(self, what, **more):
        if what == "shot":
            self.saved.append(more["path"])
        if what != "run":
            return None
        self.late -= 1
        return "late wakes" if self.late >= 0 else ""


def test_a_picture_waits_until_the_plant_keeps_time(tmp_path):
    page = Page(late=3)
    pictures.shot(page, tmp_path / "drive.webp")
    assert page.saved == [str(tmp_path / "drive.webp")]


def test_of_a_starved_computer_nothing_is_saved(tmp_path, monkeypatch):
    page = Page(late=pictures.TRIES)

    async def take(out):
        (out / "watch.webp").write_bytes(b"taken before")
        pictures.shot(page, out / "drive.webp")

    monkeypatch.setattr(pictures, "take", take)
    with pytest.raises(
        SystemExit, match=r"no picture is saved.*drive\.webp: late wakes"
    ):
        pictures.main(tmp_path / "docs")
    assert page.saved == []
    assert not (tmp_path / "docs").exists()
