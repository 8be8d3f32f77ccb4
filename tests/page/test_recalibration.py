"""The card of the recalibration: a proposal of an earlier run waits, is read and accepted."""

import json

import pytest
import yaml

from hilserver.recalibration.history import FILE, History
from hilserver.recalibration.loop import file_of
from hilserver.recalibration.proposals import Proposal, Quantity, Term
from tests.helpers.daemons import running_daemon
from tests.page.conftest import CONFIG
from tests.page.rig import page_url

pytestmark = pytest.mark.page
ON = "recalibration: {enabled: true}\n"
PROPOSAL = Proposal(
    number=1,
    causes=("rotation_gain",),
    sentence="The robot turns 3 % more than its wheel speeds say.",
    terms={"rotation_gain": Term(0.03, "1", (0.028, 0.032))},
    gain={"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))},
    patch=file_of(1),
    former=file_of(1, "-former"),
    windows=(1, 2),
)


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    """A daemon that finds a proposal in its history."""
    folder = tmp_path_factory.mktemp("recalibration")
    History(folder / "recalibration").append("proposal", proposal=PROPOSAL.as_json())
    patch = {
        "schema": "hilserver.model_patch/1",
        "made_from": {"config_sha256": "", "version": "1"},
        "terms": {"rotation_gain": {"value": 0.03, "unit": "1"}},
    }
    (folder / "patches").mkdir()
    (folder / "patches" / file_of(1)).write_text(yaml.safe_dump(patch), encoding="utf-8")
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
    browser.do("wait", selector="[aria-label='Patch']", text="recalibrated-0001.yaml is loaded.")
    assert browser.do("errors") == []
    last = (waiting.folder / "recalibration" / FILE).read_text().splitlines()[-1]
    assert json.loads(last)["proposal"]["stage"] == "accepted"
