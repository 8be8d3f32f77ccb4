"""Simulated hours: lives of a daemon with its users, in one process and from one seed each."""

import os
import re
import subprocess
import sys
from argparse import Namespace

import pytest

from tests.hours.__main__ import _Lives
from tests.hours.mutants import MUTANTS

SEEDS, SECONDS = 20, 20
LIMIT_S = 850
CAMPAIGN, PIECE = 10_000, 100


def lives(seeds, *options, seconds=SECONDS, **environment):
    """Live seeds in a process of their own, which has no clock but ours; return what it says."""
    command = [
        sys.executable,
        "-m",
        "tests.hours",
        seeds,
        "--seconds",
        str(seconds),
        *options,
    ]
    path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    env = os.environ | path | environment
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
    again = f"python -m tests.hours SEED --mode {mode} --story"
    assert " 0 with a breach" in said, f"repeat one with: {again}\n{said}"


def test_a_seed_is_the_same_life_in_every_process(tmp_path):
    """Whatever the order of sets of names, the folder, the time of day and the load."""
    one = lives("0:2", PYTHONHASHSEED="1")
    other = lives("0:2", PYTHONHASHSEED="2", TMPDIR=str(tmp_path))
    assert digests(one) == digests(other)


def test_a_failing_seed_shrinks_to_what_it_needs(monkeypatch):
    options = Namespace(mode="poll", seconds=20.0, mutant=None, without=[])
    lives, needed = _Lives(None, options), {"browser 1", "stalls"}
    result = {
        "seed": 7,
        "parts": ["program 0", "browser 1", "stalls"],
        "found": ["5.809 s: browser 1 drives after Reset"],
    }

    def forked(_seed, _plant, without):
        of_another = ["3.1 s: nobody gets in"]
        return {"found": of_another if needed & {*without} else result["found"]}

    monkeypatch.setattr(lives, "_forked", forked)
    repeat = "python -m tests.hours 7 --mode poll --without 'program 0'"
    assert lives._shrunk(result, None) == repeat


def digests(said):
    return re.findall(r"^seed \d+ (\w+)", said, re.MULTILINE)


@pytest.mark.long
@pytest.mark.parametrize("name", MUTANTS)
def test_every_planted_fault_is_found(name):
    said = lives("0:1000", "--mutant", name, "--until-found")
    print(name, said)
    assert " 1 with a breach" in said


@pytest.mark.long
@pytest.mark.parametrize("piece", range(0, CAMPAIGN, PIECE))
def test_a_campaign(piece):
    said = lives(
        f"{piece}:{piece + PIECE}", "--mode", ("poll", "subscribe")[piece // PIECE % 2]
    )
    assert " 0 with a breach" in said, said
