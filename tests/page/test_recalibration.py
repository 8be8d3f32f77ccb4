"""The card of the recalibration: a proposal of an earlier run waits, is read and accepted."""

import json

import pytest

from hilserver.recalibration.history import FILE
from tests.helpers.daemons import running_daemon
from tests.page.conftest import CONFIG
from tests.page.rig import page_url
from tests.recalibration.waiting import ON, lay_ready

pytestmark = pytest.mark.page


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    """A daemon that finds a proposal in its history."""
    folder = tmp_path_factory.mktemp("recalibration")
    lay_ready(folder)
    with running_daemon(folder, config=CONFIG + ON) as daemon:
        yield daemon
        daemon.stop()


def test_a_proposal_is_read_and_accepted(browser, waiting):
    browser.do("open", url=page_url(waiting))
    browser.do("view", name="Diagnosis")
    card = "[aria-label='Recalibration']"
    browser.do("wait", selector=card, text="turns 3 % more")
    browser.do("wait", selector=f"{card} .pairs", text="off → 0.030 (0.028 to 0.032)")
    browser.do("wait", selector=f"{card} [data-gain='gain']", text="0.060 → 0.010 (6.0")
    browser.do("click", role="button", name="Accept")
    browser.do("wait", selector=f"{card} .chip", text="accepted, being measured")
    browser.do(
        "wait",
        selector="[aria-label='Patch']",
        text="recalibrated-0001.yaml is loaded.",
    )
    assert browser.do("errors") == []
    last = (waiting.folder / "recalibration" / FILE).read_text().splitlines()[-1]
    assert json.loads(last)["proposal"]["stage"] == "accepted"
