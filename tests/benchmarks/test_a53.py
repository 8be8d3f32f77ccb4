"""Instructions of a tick, counted in an emulator."""

import argparse

import pytest

from benchmarks import a53
from hilserver.errors import FailedError


@pytest.mark.long
def test_both_processors_execute_about_as_many_instructions_and_terms_cost_more():
    """`make test` guards what it runs: tests/fmu computes the same robot on aarch64 in qemu."""
    plain, terms = a53.run(argparse.Namespace())
    assert 300 < plain.value < terms.value < 20_000
    assert 0.5 < plain.ratio < 2.0


def test_a_program_that_is_missing_is_named():
    with pytest.raises(
        FailedError, match=r"^no-such-program is not installed: 'make test-tools'"
    ):
        a53._run("no-such-program")
