"""The campaign: hidden causes in hundreds of logs, diagnosed in processes, then scored.

Results are appended to a file as they come: an interrupted campaign continues where it stopped.
With `--recordings` the logs are real ones, and simple rivals are compared with the diagnosis; or
drawings of their blocks are part of the campaign.
"""

import argparse
import datetime
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median

from hilserver_injector.cases import CLASSES, Case, cases, singles
from hilserver_injector.causes import CAUSES, REQUIRED

from benchmarks.diagnose_results import Results
from benchmarks.diagnose_rivals import rival_table
from benchmarks.diagnose_table import Record, markdown, rows
from benchmarks.diagnose_worker import Drawn, Staged, changed, work
from hilserver import __version__
from hilserver.bench.report import Result
from hilserver.errors import FailedError
from hilserver.program.workers import in_processes
from hilserver.scenarios import SCENARIOS

GROUPS = (*CLASSES, "scenario", "size")
"""`size` hides every cause at the smallest size that null logs state they would have shown."""
PROGRESS_EVERY_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the campaign."""
    parser.add_argument(
        "--class", dest="groups", default=",".join(GROUPS), metavar="A,B",
        help=f"classes of cases: {', '.join(GROUPS)}; default: all",
    )  # fmt: skip
    parser.add_argument(
        "--only", default="", metavar="NAME,..", help="only cases of these names"
    )
    parser.add_argument(
        "--seeds", type=int, default=20, metavar="N", help="seeds; default 20"
    )
    parser.add_argument(
        "--first-seed", type=int, default=0, metavar="N", help="default 0"
    )
    parser.add_argument(
        "--jobs", type=int, default=2, help="worker processes; default 2"
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="shorter logs, for a quick look"
    )
    parser.add_argument(
        "--measured-noise", action="store_true",
        help="position noise from the ultra-wideband recording in HIL_DATA_DIR",
    )  # fmt: skip
    parser.add_argument(
        "--rivals", action="store_true",
        help="ask rivals, too: mujoco.sysid, which is given the single causes, and simple ones"
        " where the pose hides one cause or none",
    )  # fmt: skip
    parser.add_argument(
        "--resume", type=Path, default=Path("diagnose-results/campaign.jsonl"), metavar="FILE",
        help="results so far, of the present sources: the campaign goes on from them and adds to"
        " them; default %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write the tables as Markdown"
    )
    parser.add_argument(
        "--recordings", nargs="+", type=_recordings, metavar="MAPPING=LOG,..",
        help="instead of hidden causes: the gain on these recordings, beside simple rivals",
    )  # fmt: skip
    parser.add_argument(
        "--public", type=Path, metavar="FOLDER",
        help="instead: public recordings, from a folder of clones, beside published methods",
    )  # fmt: skip
    parser.add_argument(
        "--time", action="store_true",
        help="instead: the CPU time of diagnoses of 10 min, or --duration, with 0, 1 and 6 effects",
    )  # fmt: skip
    parser.add_argument(
        "--drawn", type=int, default=0, metavar="N",
        help="with --recordings: a campaign on N drawings of two thirds of their blocks instead",
    )  # fmt: skip


def _recordings(text: str) -> tuple[str, list[Path]]:
    mapping, _, logs = text.partition("=")
    files = [Path(log) for log in logs.split(",") if log]
    if not mapping or not files:
        raise argparse.ArgumentTypeError(
            f"{text} is not a mapping with its logs; write both, as husky.yaml=run1.csv,run2.csv"
        )
    return mapping, files


def run(args: argparse.Namespace) -> list[Result]:
    """Run what has no result yet, print the tables and return their rows."""
    if args.time:
        from benchmarks.diagnose_time import time_spent  # noqa: PLC0415 (slow to import)

        return time_spent(args.duration, args.jobs)
    if args.seeds < 1 or args.jobs < 1:
        msg = "--seeds and --jobs must be at least 1."
        raise FailedError(msg)
    if args.public:
        from benchmarks.diagnose_public import measure as publicly  # noqa: PLC0415 (slow to import)

        return publicly(args.public, args.resume, args.jobs)
    if args.recordings and not args.drawn:
        from benchmarks.diagnose_recordings import measure  # noqa: PLC0415 (slow to import)

        return measure(args.recordings, args.resume, args.jobs)
    length = "" if args.duration is None else f"{args.duration:g} s"
    noise = "measured noise" if args.measured_noise else ""
    rival = "rivals" if args.rivals else ""
    if args.rivals:
        from benchmarks.campaign_rivals import require  # noqa: PLC0415 (slow to import)

        require()
    results = Results(args.resume, ", ".join(filter(None, (length, noise, rival))))
    try:
        asked = _work_off(args, results)
    except SystemExit:
        print(_text(list(results.records.values()), results))
        print(f"stopped; the same command goes on from {results.file}", file=sys.stderr)
        raise
    mine = [results.records[key] for key in asked if key in results.records]
    text = _text(mine, results)
    print(text)
    if args.out is not None:
        args.out.write_text(text, encoding="utf-8")
    return [row.as_result() for row in rows(mine) if row.trials]


def _text(records: Sequence[Record], results: Results) -> str:
    return markdown(records, [*_heading(results), "", *rival_table(records)])


def _groups(text: str) -> list[str]:
    groups = [word.strip() for word in text.split(",") if word.strip()]
    for group in groups:
        if group not in GROUPS:
            msg = f"--class {group}: no such class; there are {', '.join(GROUPS)}."
            raise FailedError(msg)
    return groups


def _drawn(args: argparse.Namespace) -> Iterator[Drawn]:
    """Yield the wanted number of drawings, from the recordings in turn."""
    files = [(mapping, file) for mapping, files in args.recordings for file in files]
    for k in range(args.drawn):
        mapping, file = files[k % len(files)]
        yield Drawn(mapping, file, args.first_seed + k // len(files))


def _wanted(
    args: argparse.Namespace, group: str, records: Sequence[Record]
) -> Iterator[Case | Staged | Drawn]:
    if group == "recording":
        yield from _drawn(args)
        return
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    only = {word for word in args.only.split(",") if word}
    if group == "scenario":
        yield from (
            Staged(n, s) for n in SCENARIOS if not only or n in only for s in seeds
        )
        return
    found = (
        _at_smallest_size(records, seeds) if group == "size" else cases(group, seeds)
    )
    for case in found:
        if not only or only & set(case.name.split("+")):
            yield changed(case, args.duration, args.measured_noise)


def _at_smallest_size(records: Iterable[Record], seeds: range) -> Iterator[Case]:
    """Yield every required cause at the median of the sizes that null logs of its kind state."""
    nulls = [r for r in records if r["group"] == "null"]
    if not nulls:
        msg = (
            "--class size needs the sizes that null logs state: run --class null,size."
        )
        raise FailedError(msg)
    for name in REQUIRED:
        cause = CAUSES[name]
        stated = [r["smallest"] for r in nulls if r["kind"] == cause.kind]
        sizes = [s[key] for s in stated for key in (cause.parameter, name) if key in s]
        if not sizes or name == "setpoint_rate_limit":
            continue
        scale = median(sizes) / abs(cause.size - cause.base)
        for seed in seeds:
            for case in singles(seed, scale, (name,)):
                yield replace(case, group="size")


def _work_off(args: argparse.Namespace, results: Results) -> list[str]:
    """Run every case that has no result; return the keys of all requested cases."""
    asked: list[str] = []
    job = partial(work, with_rivals=True) if args.rivals else work
    for group in ["recording"] if args.recordings else _groups(args.groups):
        wanted = list(_wanted(args, group, list(results.records.values())))
        asked += [case.key for case in wanted]
        todo = [case for case in wanted if case.key not in results.records]
        begin, shown = time.monotonic(), 0.0
        with closing(in_processes(job, todo, args.jobs)) as records:
            for done, (_, record) in enumerate(records, 1):
                results.add(record)
                now = time.monotonic() - begin
                if now - shown > PROGRESS_EVERY_S or done == len(todo):
                    shown = now
                    left = now / done * (len(todo) - done)
                    print(
                        f"{group}: {done} of {len(todo)}, {left:.0f} s left",
                        file=sys.stderr,
                    )
    return asked


def _commit() -> str:
    """Return the commit of the sources, with ``-changed`` when they differ from it."""
    folder = Path(__file__).parent

    def git(*words: str) -> str:
        command = ["git", "-C", str(folder), *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        return done.stdout.strip() if done.returncode == 0 else ""

    commit = git("rev-parse", "--short=10", "HEAD")
    if not commit:
        return f"version-{__version__}"
    changed = git(
        "status", "--porcelain", "--untracked-files=no", "--", ".", "../hilserver"
    )
    return f"{commit}-changed" if changed else commit


def _heading(results: Results) -> list[str]:
    words = shlex.join(["hilserver", *sys.argv[1:]])
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    made = f"commit `{_commit()}`, sources `{results.stamp['sources']}`, {today}"
    lines = ["# Campaign of the diagnosis", "", f"`{words}`, {made}."]
    if results.others:
        lines[-1] += (
            f" {results.others} results of other sources or settings are not counted."
        )
    return lines
