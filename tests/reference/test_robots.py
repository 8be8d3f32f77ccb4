"""Robots and how-tos: every cell is green, or refused with the reason that the page states."""

import pytest

from reference import robots


def test_the_page_has_every_robot_and_every_how_to():
    page = robots.PAGE.read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| [")]
    assert [row.split(" | ")[0] for row in rows] == [
        f"| {how_to.page}" for how_to in robots.HOW_TOS
    ]
    assert all(f"| {name} | `plant: " in page for name in robots.ROBOTS)


@pytest.mark.long
def test_every_robot_does_what_the_page_says():
    found = {robot: list(robots.outcomes(robot)) for robot in robots.ROBOTS}
    assert robots.as_markdown(found) == robots.PAGE.read_text(encoding="utf-8")
