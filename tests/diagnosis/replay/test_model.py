"""A model of causes, each at its values."""

from hilserver.diagnosis.catalogue.library import drive_candidates
from hilserver.diagnosis.replay.model import Model

CANDIDATES = {c.label: c for c in drive_candidates()}


def test_a_cause_that_is_taken_with_more_parameters_stands_in_its_own_place():
    """Twice in a model, one of its values would do nothing."""
    model = Model().plus(CANDIDATES["controller_gains.p"], (-0.1,))
    model = model.plus(CANDIDATES["coulomb_friction"], (2.0,))
    model = model.plus(CANDIDATES["controller_gains"], (-0.2, 0.1))
    assert model.causes == ("coulomb_friction", "controller_gains")
    assert model.terms == {
        "coulomb_friction": 2.0, "controller_gains.p": -0.2, "controller_gains.i": 0.1
    }  # fmt: skip


def test_causes_that_share_no_term_stand_side_by_side():
    model = Model().plus(CANDIDATES["controller_gains.p"], (-0.1,))
    model = model.plus(CANDIDATES["controller_gains.i"], (0.2,))
    assert model.causes == ("controller_gains", "controller_gains")
