"""Two logs drawn over each other on the page, read by one cursor."""

import csv
import math

import pytest

from tests.page.rig import diagnoses, lift

pytestmark = pytest.mark.page
ROWS, PERIOD_S = 6_000, 0.01
PARTS_AT_S = 40.0
WITHIN_S = 2.0


def write(path, error_m):
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t_s", "pose.x_m", "pose.y_m"])
        for i in range(ROWS):
            t_s = i * PERIOD_S
            x_m = math.sin(0.1 * t_s) + (error_m if t_s >= PARTS_AT_S else 0.0)
            rows.writerow([repr(t_s), repr(x_m), repr(2.0 * x_m)])


def test_two_logs_are_drawn_over_each_other(browser, url, plant, daemon):
    folder = daemon.folder / "recordings"
    folder.mkdir(exist_ok=True)
    write(folder / "before.csv", 0.0)
    write(folder / "after.csv", 0.25)
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name="Compare before.csv")
    browser.do(
        "run", script="document.querySelector('dialog select').value = 'after.csv'"
    )
    browser.do("run", script="document.querySelector('dialog .primary').click()")
    is_shown = "document.querySelectorAll('.compared .plot').length == 2"

    def shown():
        for pid in diagnoses(daemon, "compare"):
            lift(pid)
        return browser.do("run", script=is_shown)

    plant.wait(shown)
    browser.do("wheel", selector=".compared .u-over", at=0.9, dy=0)
    browser.do("wait", selector=".compared output", text="difference 0.250 m")
    script = (
        """[...document.querySelectorAll('.compared output')].map((o) => o.innerText)"""
    )
    of_x, of_y = browser.do("run", script=script)
    assert of_x.split(":")[0] == of_y.split(":")[0]  # one cursor reads both
    assert "difference 0.500 m" in of_y
    assert browser.do("axe") == []
    assert browser.do("errors") == []
