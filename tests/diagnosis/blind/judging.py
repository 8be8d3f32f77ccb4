"""Logs as files to `hilserver diagnose` in a process of its own; its answers beside the truth."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.diagnose_scoring import loud, names, score
from hilserver.diagnosis.schema.findings import Findings
from hilserver.plant.terms import TERMS, main_part

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = """\
import sys
from hilserver.commands import main
code = main(sys.argv[1:])
generators = [name for name in sys.modules if "injector" in name or "scenarios" in name]
sys.exit(f"what diagnosed has loaded {generators}" if generators else code)
"""
LONGEST_S = 1800.0
NAMED = ("alone", "group of two", "larger group", "beside another")
"""How the truth can have a name; `beside another` is one that is not hidden there."""

WITHOUT_A_NAME = {"nothing_found": "silent", "structure_not_in_library": "flagged"}
"""How the right answer is called where no cause of the library is hidden, by its verdict."""


def diagnosed(logs, machine="skid"):
    """The findings of every log; its files say neither who made it nor from which seed."""
    with TemporaryDirectory(prefix="blind-") as folder:
        files = [f"{folder}/log-{number}.csv" for number in range(1, len(logs) + 1)]
        for file, table in zip(files, logs, strict=True):
            table.write_csv(Path(file))
        config = Path(folder, "config.yaml")
        config.write_text(f"plant: {{drive: {machine}}}\n", encoding="utf-8")
        words = [
            "diagnose",
            *files,
            "--each",
            "--jobs",
            "1",
            "-c",
            str(config),
            "-o",
            folder,
        ]
        run = subprocess.run(
            [sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, check=False,
            cwd=ROOT, timeout=LONGEST_S, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert run.returncode == 0, run.stderr
        found = [Path(file).with_suffix("") / "findings.json" for file in files]
        return [
            Findings.model_validate_json(file.read_text(encoding="utf-8"))
            for file in found
        ]


@dataclass(frozen=True)
class Told:
    """What came out of one log."""

    # one of NAMED; or missed, unknown (a structure instead of a name), vague; where no cause of the
    # library is hidden: silent, flagged, or false_alarm
    how: str
    # names of what is not there, and of signs that are not the true ones
    wrong: tuple[str, ...]
    values: int  # parameters that have a value
    near: int  # of them: within 20 % of the truth, or the truth within their interval
    said: tuple[str, ...]

    @property
    def is_named(self):
        """Whether the truth has a name, with no false one beside it."""
        return self.how in NAMED and not self.wrong


def told(made, findings):
    """Compare what was found in a log with what is hidden in it."""
    result = score(made, findings)
    wrong = list(result.wrong)
    for name, value in result.values.items():
        null = TERMS[main_part(name)].null or 0.0
        # an interval that holds the truth, on the other side of null, claims no sign
        if (value.fitted - null) * (value.true - null) <= 0.0 and not value.in_ci95:
            wrong.append(f"sign of {name}")
    near = sum(bool(v.within_20 or v.in_ci95) for v in result.values.values())
    how = result.outcome
    if how == "right":
        how = WITHOUT_A_NAME.get(made.answer.verdict) or _named_how(made, findings)
    return Told(how, tuple(wrong), len(result.values), near, tuple(result.found))


def _named_how(made, findings):
    truth = frozenset().union(*made.answer.causes)
    found = loud(findings)
    holding = [finding for finding in found if names(finding) & truth]
    if len(holding) < len(found):
        return "beside another"
    largest = max(len(names(finding)) for finding in holding)
    return {1: "alone", 2: "group of two"}.get(largest, "larger group")
