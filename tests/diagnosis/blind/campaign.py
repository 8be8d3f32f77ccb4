"""All causes, pairs, faults beside causes and effects outside the library, of both generators.

    python -m tests.diagnosis.blind --results FILE [--rounds N] [--classes single,pair]

A round is one drive of each kind per generator, with all that is hidden in it. Every answer is a
line of JSON in FILE, so a campaign that was stopped goes on; answers of another engine or generator
are not counted. The secret is the hash of all of these: changed sources get logs never seen before.
"""

import hashlib
import itertools
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np
from hilserver_injector import CAUSES
from hilserver_injector.cases import outside
from hilserver_injector.causes import TWINS

from benchmarks.binomial import clopper_pearson
from benchmarks.diagnose_results import Results, sources
from tests.diagnosis.blind.drawing import (
    FIRST,
    LENGTH_S,
    MAKERS,
    Hidden,
    Shown,
    kind_of,
    pair,
    seed_of,
)
from tests.diagnosis.blind.judging import NAMED
from tests.diagnosis.blind.rounds import Round, judged

CLASSES = ("null", "single", "pair", "fault", "outside")
PAIRS, BESIDE_A_FAULT = 8, 8
BATCH = 6
UNNAMED = frozenset({"backlash"})
"""Causes that no diagnosis names: a wrong name is all that can come out."""


def secret():
    """The hash of all sources on which an answer depends."""
    own = hashlib.sha256()
    for name in ("second.c", "drawing.py", "judging.py", "rounds.py"):
        own.update(Path(__file__).with_name(name).read_bytes())
    return f"{sources()}-{own.hexdigest()[:12]}"


def wanted(made, maker, classes):
    """Yield class and logs of a round, whose drives are measured."""
    causes = [cause for cause in CAUSES if made.can_hide(cause)]
    if "single" in classes:
        for cause in causes:
            if (log := made.hidden(cause)) is not None:
                yield ("unnamed" if cause in UNNAMED else "single"), log
    rng = np.random.default_rng(seed_of(made.secret, maker, "pairs"))
    both = [
        two for two in itertools.combinations([c for c in causes if c not in UNNAMED], 2)
        if kind_of(two[0]) == kind_of(two[1]) and frozenset(two) not in TWINS
    ]  # fmt: skip
    picked = [both[k] for k in rng.choice(len(both), PAIRS, replace=False)]
    if "pair" in classes:
        for one, other in (
            tuple(made.hidden(cause, "pair") for cause in two) for two in picked
        ):
            if one is not None and other is not None:
                yield "pair", pair(one, other)
    if "fault" in classes:
        for cause in rng.permutation(causes).tolist()[:BESIDE_A_FAULT]:
            log = made.hidden(cause, "fault", fault=True)
            if log is not None and cause not in UNNAMED:
                yield "fault", log
    if "outside" in classes:
        drive, seed = (
            made.drive_of("rotation_gain"),
            seed_of(made.secret, maker, "outside"),
        )
        for case in outside(seed):
            effect = case.recipe.causes
            if drive.can_hide(effect):
                yield "outside", Hidden(drive, case.name, effect, seed, case.answer)


def run(file, rounds=1, makers=MAKERS, classes=CLASSES, first=0, say=print):
    """Judge what has no answer yet; return the answers to all that was wanted."""
    results = Results(file, "blind", secret())
    keys = []
    for number, maker in itertools.product(range(first, first + rounds), makers):
        kinds = {
            kind: maker
            for kind in LENGTH_S
            if maker == FIRST or kind in ("drive", "bench")
        }
        made = Round(f"{secret()}/{number}/{maker}", kinds, LENGTH_S)
        keys += _nulls(made, maker, number, results)
        todo = []
        for group, log in wanted(made, maker, classes):
            keys.append(key := f"{number}/{maker}/{group}/{log.name}")
            if key not in results.records:
                todo.append((key, group, log))
        for begin in range(0, len(todo), BATCH):
            batch = todo[begin : begin + BATCH]
            answers = judged([log for _, _, log in batch])
            for (key, group, log), (said, _) in zip(batch, answers, strict=True):
                results.add(_record(key, group, maker, log, said))
            say(f"round {number}, {maker} generator: {len(results.records)} answers")
    return [results.records[key] for key in keys]


def _nulls(made, maker, number, results):
    """Judge the round's drives with nothing hidden, or take what an earlier run was told."""
    able = [made.drive_of(cause) for cause in CAUSES if made.can_hide(cause)]
    drives = {
        f"{number}/{maker}/null/{drive.kind}": drive for drive in dict.fromkeys(able)
    }
    for key in drives.keys() & results.records.keys():
        made.shown[drives[key]] = Shown(**results.records[key]["shown"])
    for log, said in made.measure(drives.values()):
        key = f"{number}/{maker}/null/{log.drive.kind}"
        shown = {"shown": asdict(made.shown[log.drive])}
        results.add(_record(key, "null", maker, log, said) | shown)
    return list(drives)


def _record(key, group, maker, log, said):
    return {
        "key": key, "group": group, "maker": maker, "name": log.name, "kind": log.drive.kind,
        "causes": dict(log.causes), "how": said.how, "wrong": list(said.wrong),
        "values": said.values, "near": said.near, "said": list(said.said),
    }  # fmt: skip


def table(records):
    """The campaign in a table, and every log in which something was missed or wrong."""
    how = [*NAMED, "vague", "unknown", "missed"]
    lines = [
        f"| logs | class | number | {' | '.join(how)} | wrong name, 95 % below | value near |"
    ]
    lines.append("|---" * (len(how) + 5) + "|")
    for maker, group in itertools.product((*MAKERS, "both"), CLASSES):
        mine = [
            r for r in records if r["group"] == group and maker in (r["maker"], "both")
        ]
        if not mine:
            continue
        counted = Counter(r["how"] for r in mine)
        wrong = sum(bool(r["wrong"]) for r in mine)
        most = 100.0 * clopper_pearson(wrong, len(mine))[1]
        near, values = sum(r["near"] for r in mine), sum(r["values"] for r in mine)
        counts = " | ".join(str(counted[one]) for one in how)
        if group in ("null", "outside"):
            good = counted["silent"] + counted["flagged"]
            counts = f"{good} right |" + " |" * (len(how) - 1)
        cells = [
            maker,
            group,
            len(mine),
            counts,
            f"{wrong}, {most:.1f} %",
            f"{near} of {values}",
        ]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines.append("")
    for one in records:
        if one["wrong"] or one["how"] not in (*NAMED, "silent", "flagged"):
            more = {name: one[name] for name in ("wrong", "said", "causes")}
            lines.append(f"{one['key']}: {one['how']}, {more}")
    return "\n".join(lines)
