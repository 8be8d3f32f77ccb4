"""Simulated hours: lives of a daemon with its users, in one process and from one seed each."""

import os
import re
import subprocess
import sys

import pytest

from tests.hours.mutants import MUTANTS, first_seed

SEEDS, SECONDS = 20, 20
LIMIT_S = 1200
CAMPAIGN, PIECE = 10_000, 100


def lives(seeds, *options, seconds=SECONDS):
    """Live seeds in a process of their own, which has no clock but ours; return what it says."""
    command = [sys.executable, "-m", "tests.hours", seeds, "--seconds", str(seconds), *options]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    run = subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, env=env, check=False
    )
    assert "simulated" in run.stdout, run.stdout + run.stderr
    return run.stdout


@pytest.mark.parametrize("mode", ["poll", "subscribe"])
def test_nobody_finds_anything(mode):
    first = 0 if mode == "poll" else SEEDS // 2
    said = lives(f"{first}:{first + SEEDS // 2}", "--mode", mode)
    print(said)  # seconds simulated per second of processor time
    assert " 0 with a breach" in said, f"repeat one with: python -m tests.hours SEED\n{said}"


def test_a_seed_is_the_same_life_every_time():
    once, again = (lives("3", seconds=8) for _ in range(2))
    digests = [re.search(r'"digest": "(\w+)"', said)[1] for said in (once, again)]
    assert digests[0] == digests[1]


def test_the_judges_see_a_stick_that_is_held_over_a_reset():
    said = lives("4", "--mutant", "reset restarts a held stick")
    assert "without having let go" in said


@pytest.mark.long
@pytest.mark.parametrize("name", MUTANTS)
def test_every_planted_fault_is_found(name):
    found = first_seed(name)
    assert found is not None
    print(name, found)


@pytest.mark.long
@pytest.mark.parametrize("piece", range(0, CAMPAIGN, PIECE))
def test_a_campaign(piece):
    said = lives(f"{piece}:{piece + PIECE}", "--mode", ("poll", "subscribe")[piece // PIECE % 2])
    assert " 0 with a breach" in said, said
