"""The ledger of tests counts: ``pytest -p tests.helpers.ledger``."""

from tests.helpers import ledger


def test_rooms_and_steps_are_counted():
    assert ledger.room_of("tests/kernel/test_parts.py::test_one") == "kernel"
    assert ledger.room_of("tests/test_docs.py::test_one") == "test_docs.py"
    assert ledger._steps() >= 0
