"""The table of the daemon's own recordings: 60 without an effect and 36 with one term.

``python -m tests.diagnosis.own_recordings --results FILE`` runs what FILE has no line for yet.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from tests.diagnosis.assertions import LARGEST_GROUP, said
from tests.diagnosis.own_recordings.cases import DROVE, HIDDEN, ROWS
from tests.diagnosis.own_recordings.recordings import found_in, read


def cases():
    """Every case: its name, drive and rows, and the cause that must be named."""
    for name, drive in DROVE.items():
        for label, rows in ROWS.items():
            yield f"nothing: {name}: {label}", drive, rows, None
    for hidden in HIDDEN:
        yield f"term: {hidden.cause}", hidden.drive, hidden.rows, hidden.cause


def is_right(findings, cause):
    """Whether nothing was found, or the cause alone or in its group."""
    if cause is None:
        return not findings.findings
    if len(findings.findings) != 1:
        return False
    (finding,) = findings.findings
    return cause in finding.causes and len(finding.causes) <= LARGEST_GROUP


def main():
    """Run the open cases; say how many are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--results", type=Path, required=True, help="one line of JSON per case"
    )
    parser.add_argument("--only", default="", help="only cases whose name holds this")
    args = parser.parse_args()
    lines = args.results.read_text().splitlines() if args.results.exists() else []
    done = {record["case"]: record for record in map(json.loads, lines)}
    wanted = [case for case in cases() if args.only in case[0]]
    with tempfile.TemporaryDirectory() as folder, args.results.open("a") as out:
        made = {}
        for number, (name, drive, rows, cause) in enumerate(wanted, 1):
            if name in done:
                continue
            begun = time.monotonic()
            key = repr(drive)
            if key not in made:
                (home := Path(folder) / str(number)).mkdir()
                made[key] = drive.record(home / "run.mcap")
            findings = found_in(read(made[key], made[key].parent, rows))
            if cause is not None:
                made.pop(key).unlink()
            seconds = round(time.monotonic() - begun, 1)
            right = is_right(findings, cause)
            record = {
                "case": name,
                "right": right,
                "found": said(findings),
                "seconds": seconds,
            }
            done[name] = record
            out.write(json.dumps(record) + "\n")
            out.flush()
            print(f"{number} of {len(wanted)}: {record}", file=sys.stderr)
    judged = [done[name] for name, *_ in wanted if name in done]
    print(f"{sum(record['right'] for record in judged)} of {len(judged)} right")
    return 0 if all(record["right"] for record in judged) else 1


if __name__ == "__main__":
    sys.exit(main())
