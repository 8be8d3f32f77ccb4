"""The twin as a browser sees it: ``python -m tests.page.twin OUT.webp``, on a quiet computer.

Starts ``hilserver run --twin``, waits for the proposal in view Diagnosis, accepts it, and waits
until its effect is measured. Prints time to the proposal and gap before and after; takes pictures.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from hilserver.recalibration.history import FILE
from tests.helpers.daemons import running_daemon
from tests.page.rig import Browser, Plant, page_url

CONFIG = """
page: {port: 0}
scheduler:
  realtime: {priority: 0, lock_memory: false, hold_latency_target: false}
  limits: {single_overrun_ms: null, consecutive_overruns: null}
  communication_timeout_ms: 0
"""
LONGEST_S = 1500.0
CARD = "[aria-label='Recalibration']"


def follow(out: Path) -> dict[str, object]:
    """Follow the twin until its effect is measured; return what was seen."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running_daemon(Path(folder), "--twin", config=CONFIG) as daemon,
    ):
        history, plant = Path(folder) / "recalibration" / FILE, Plant(daemon.image)
        browser = Browser(webgl=False)
        try:
            begun_s = time.monotonic()
            browser.do("fresh")
            browser.do("open", url=page_url(daemon))
            browser.do("view", name="Diagnosis")
            plant.wait(lambda: has(history, "proposal"), LONGEST_S)
            seconds = time.monotonic() - begun_s
            browser.do("wait", selector=f"{CARD} .chip", text="open")
            browser.do("shot", path=str(out))
            browser.do("click", role="button", name="Accept")
            browser.do("wait", selector=f"{CARD} .chip", text="accepted")
            plant.wait(lambda: has(history, "effect"), LONGEST_S)
            browser.do("wait", selector=f"{CARD} .chip", text="better")
            after = out.with_name(f"{out.stem}-after{out.suffix}")
            browser.do("shot", path=str(after))
        finally:
            for line in lines_of(history):
                print(
                    line["kind"], line.get("verdict", ""), said(line), file=sys.stderr
                )
            browser.close()
            daemon.stop()
        (effect,) = has(history, "effect")
        return {"seconds_to_proposal": round(seconds), **effect["proposal"]}


def lines_of(history: Path) -> list[dict]:
    """Return all lines."""
    if not history.exists():
        return []
    return [json.loads(line) for line in history.read_text().splitlines()]


def has(history: Path, kind: str) -> list[dict]:
    """Return the lines of one kind."""
    return [line for line in lines_of(history) if line["kind"] == kind]


def said(line: dict) -> str:
    """Return what a line says."""
    return (
        line.get("sentence")
        or line.get("error")
        or line.get("proposal", {}).get("sentence", "")
    )


def main() -> int:
    """Follow, and print what was seen."""
    parser = argparse.ArgumentParser(prog="python -m tests.page.twin")
    parser.add_argument("out", type=Path)
    print(json.dumps(follow(parser.parse_args().out.resolve()), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
