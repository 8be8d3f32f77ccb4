"""A proposal that an earlier run has left to be decided on."""

import yaml

from hilserver.recalibration.history import History
from hilserver.recalibration.loop import file_of
from hilserver.recalibration.proposals import Proposal, ProposedTerm, Quantity

ON = "recalibration: {enabled: true}\n"
PROPOSAL = Proposal(
    number=1,
    causes=("rotation_gain",),
    sentence="The robot turns 3 % more than its wheel speeds say.",
    terms={"rotation_gain": ProposedTerm(0.03, "1", (0.028, 0.032))},
    gain={"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))},
    patch=file_of(1),
    former=file_of(1, "-former"),
    windows=(1, 2),
)


def lay_ready(folder):
    """Write the proposal and its patch into the folder of a daemon."""
    History(folder / "recalibration").append("proposal", proposal=PROPOSAL.as_json())
    patch = {
        "schema": "hilserver.model_patch/1",
        "made_from": {"config_sha256": "", "version": "1"},
        "terms": {"rotation_gain": {"value": 0.03, "unit": "1"}},
    }
    (folder / "patches").mkdir()
    (folder / "patches" / file_of(1)).write_text(
        yaml.safe_dump(patch), encoding="utf-8"
    )
