"""Diagnoses and comparisons started on the page: processes with idle priority and limited memory.

One of a kind at a time; others wait for their turn.
"""

import asyncio
import contextlib
import logging
import os
import re
import sys
import time
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hilserver.errors import EXIT_DIFFERENT, EXIT_DONE
from hilserver.io.page.files import file_in, files_in, is_plain, reports_in
from hilserver.io.page.hand import RefusedError
from hilserver.io.page.setup import Setup
from hilserver.program.whole_file import write_whole
from hilserver.tasks import SupervisedTask, Supervisor

MAX_KEPT = 20
MAX_WAITING = 10
SHARE_OVER_S = 8.0
MAPPING_CHARACTERS = 32_768
MAPPING = ".mapping.yaml"
_PROGRESS = re.compile(r"^\s*(\d{1,3})% (.{1,200})$")

_log = logging.getLogger(__name__)


class ShareOfTime:
    """Whether a process gets hardly any time: idle priority gets only what others leave."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, float]] = deque(maxlen=32)

    def is_small(self, pid: int, over_s: float = SHARE_OVER_S) -> bool:
        """Whether it had less than a tenth of the last `over_s`, once that time has passed."""
        now_s = time.monotonic()
        if not self._marks or now_s - self._marks[-1][0] >= over_s / 8:
            try:
                words = (
                    Path(f"/proc/{pid}/stat")
                    .read_text(encoding="ascii")
                    .rsplit(")", 1)[1]
                )
            except (OSError, IndexError):
                return False
            # with ended children: proc(5)
            ticks = sum(int(word) for word in words.split()[11:15])
            self._marks.append((now_s, ticks / os.sysconf("SC_CLK_TCK")))
        while len(self._marks) > 2 and now_s - self._marks[1][0] >= over_s:
            self._marks.popleft()
        (then_s, then_used_s), (last_s, used_s) = self._marks[0], self._marks[-1]
        return last_s - then_s >= over_s / 2 and used_s - then_used_s < 0.1 * (
            last_s - then_s
        )


@dataclass
class Job:
    """One diagnosis or comparison.

    Attributes
    ----------
    log : str
        What it works on.
    kind : str
        "diagnosis" or "comparison".
    """

    number: int
    log: str
    folder: Path
    kind: str = "diagnosis"
    state: str = "waiting"
    share: float = 0.0
    stage: str = "starting"
    text: str = ""
    started_s: float = field(default_factory=time.time)
    process: asyncio.subprocess.Process | None = None
    task: SupervisedTask | None = None
    share_of_time: ShareOfTime = field(default_factory=ShareOfTime)
    files: list[str] = field(default_factory=list)

    def view(self) -> dict[str, Any]:
        """Return what a browser shows."""
        keys = ("number", "kind", "log", "state", "share", "stage", "text", "started_s")
        if self.state == "done" and not self.files:  # nothing is added later
            self.files = [f["name"] for f in files_in(self.folder)]
        pid = self.process.pid if self.process and self.state == "running" else None
        return {key: getattr(self, key) for key in keys} | {
            "folder": self.folder.name,
            "files": self.files,
            "waits": pid is not None and self.share_of_time.is_small(pid),
            "mapping": self._guess() if self.state == "failed" else "",
        }

    def _guess(self) -> str:
        """Return the mapping that the diagnosis guessed for a log of others."""
        try:
            with (self.folder / "mapping.yaml").open(encoding="utf-8") as file:
                return file.read(MAPPING_CHARACTERS)
        except (OSError, UnicodeDecodeError):
            return ""


class Jobs:
    """Starts, follows and ends them; diagnoses of earlier runs are known by their reports."""

    def __init__(self, setup: Setup, tasks: Supervisor | None = None) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self._setup = setup
        self._jobs: list[Job] = []
        self._turns = {"diagnosis": asyncio.Lock(), "comparison": asyncio.Lock()}
        reports = setup.folder("reports")
        earlier = [row for row in reports_in(reports) if row["title"] is not None][
            :MAX_KEPT
        ]
        for number, row in enumerate(reversed(earlier), 1):
            name, title, at_s = row["name"], row["title"], row["modified_s"]
            self._jobs.append(
                Job(
                    number,
                    name,
                    reports / name,
                    state="done",
                    share=1.0,
                    stage="",
                    text=title,
                    started_s=at_s,
                )
            )
        self._next = len(earlier) + 1

    def view(self) -> list[dict[str, Any]]:
        """Return all jobs, the newest first."""
        return [job.view() for job in reversed(self._jobs)]

    def diagnose(self, log: object, mapping: str = "") -> int:
        """Start a diagnosis of a log, which waits for its turn; return its number.

        `mapping` names a built-in one; without it the one saved for the log is used.
        RefusedError if there is no such log, or too many wait.
        """
        path = file_in(self._setup.folder("recordings"), log)
        if mapping and mapping not in self._setup.mappings:
            raise RefusedError(f"there is no built-in mapping '{mapping:.60}'")
        own = path.with_name(path.name + MAPPING)
        if not mapping and own.is_file():
            mapping = str(own)
        words = ["diagnose", str(path), "--jobs", "1"]
        if mapping:
            words += ["--mapping", mapping]
        if self._setup.config_file:
            words += ["-c", self._setup.config_file]
        return self._start("diagnosis", path.name, path.stem, words)

    def compare(self, a: object, b: object) -> int:
        """Start a comparison of two logs; return its number.

        RefusedError if there is no such log, or too many wait.
        """
        folder = self._setup.folder("recordings")
        first, second = file_in(folder, a), file_in(folder, b)
        words = ["compare", str(first), str(second)]
        log = f"{first.name} and {second.name}"
        return self._start("comparison", log, f"{first.stem}-{second.stem}", words)

    def _start(self, kind: str, log: str, name: str, words: list[str]) -> int:
        if sum(job.state == "waiting" for job in self._jobs) >= MAX_WAITING:
            raise RefusedError(
                f"{MAX_WAITING} jobs are waiting: cancel one, or try again later"
            )
        stamp = time.strftime("%Y%m%d-%H%M%SZ", time.gmtime())
        folder = self._setup.folder("reports") / f"{name[:60]}-{stamp}"
        while any(job.folder == folder for job in self._jobs):
            folder = folder.with_name(f"{folder.name}-{self._next}")
        job = Job(self._next, log, folder, kind)
        self._next += 1
        ended = [j for j in self._jobs if j.state not in ("running", "waiting")]
        if len(self._jobs) >= MAX_KEPT and ended:  # what runs is never forgotten
            self._jobs.remove(ended[0])
        self._jobs.append(job)
        job.task = self._tasks.spawn(partial(self._run, job, words), kind)
        return job.number

    def map(self, log: object, text: str) -> None:
        """Save a mapping for a log, for its next diagnoses; an empty one removes it."""
        path = file_in(self._setup.folder("recordings"), log)
        own = path.with_name(path.name + MAPPING)
        if len(text) > MAPPING_CHARACTERS:
            raise RefusedError(f"a mapping has at most {MAPPING_CHARACTERS} characters")
        if text.strip():
            _store(own, text.encode())
        else:
            own.unlink(missing_ok=True)

    def cancel(self, number: object) -> None:
        """End a job; there is no report then."""
        job = self._find(number, "running", "waiting")
        if job.state == "waiting":  # nothing of it is left
            self._jobs.remove(job)
        job.state = "cancelled"
        _terminate(job)

    def keep(self, number: object) -> str:
        """Copy the patch of a finished diagnosis to the patches; return its name there."""
        job = self._find(number, "done")
        source = job.folder / "model_patch.yaml"
        if not source.is_file():
            raise RefusedError(f"the diagnosis of {job.log} has no patch")
        target = self._setup.folder("patches") / f"{job.folder.name}.yaml"
        _store(target, source.read_bytes())
        return target.name

    def _find(self, number: object, *states: str) -> Job:
        for job in self._jobs:
            if job.number == number and job.state in states:
                return job
        raise RefusedError(f"there is no such job that is {' or '.join(states)}")

    def report(self, folder: str, name: str) -> Path | None:
        """Return a file of a finished job."""
        for job in self._jobs:
            if job.folder.name == folder and job.state == "done" and is_plain(name):
                path = job.folder / name
                return path if path.is_file() else None
        return None

    async def close(self) -> None:
        """End whatever runs."""
        for job in self._jobs:
            _terminate(job)
        for job in tuple(self._jobs):
            if job.task is not None:
                await job.task.end()

    async def _run(self, job: Job, words: list[str]) -> None:
        command = [sys.executable, "-m", "hilserver.io.page.quietly", *words]
        async with self._turns[job.kind]:
            if job.state != "waiting":  # cancelled meanwhile
                return
            job.state, job.started_s = "running", time.time()
            try:
                job.process = await asyncio.create_subprocess_exec(
                    *command,
                    "-o",
                    str(job.folder),
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.PIPE,
                    stderr=asyncio.subprocess.STDOUT,
                    start_new_session=True,
                )
                if job.state != "running":  # cancelled meanwhile
                    _terminate(job)
                await self._follow(job, job.process)
                code = await job.process.wait()
                if job.state == "running":
                    is_done = code in (EXIT_DONE, EXIT_DIFFERENT)
                    job.state = "done" if is_done else "failed"
                    job.share = 1.0 if is_done else job.share
            except (OSError, ValueError) as error:
                job.state, job.text = "failed", str(error)
            finally:
                if job.process is not None and job.process.returncode is None:
                    job.process.kill()
                    await job.process.wait()
            _log.info("page: the %s of %s: %s", job.kind, job.log, job.state)

    async def _follow(self, job: Job, process: asyncio.subprocess.Process) -> None:
        lines: deque[str] = deque(maxlen=12)
        while process.stdout is not None and (data := await process.stdout.readline()):
            text = data.decode(errors="replace").rstrip()[:400]
            line = text.replace(f"{job.folder.parent}/", "")  # without our folders
            if match := _PROGRESS.match(line):
                job.share, job.stage = int(match[1]) / 100, match[2]
            else:
                lines.append(line)
                job.text = "\n".join(lines)


def _store(path: Path, content: bytes) -> None:
    """Write a file as a whole; RefusedError if that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise RefusedError(f"{path.name} cannot be stored: {error.strerror}") from None


def _terminate(job: Job) -> None:
    if job.process is not None and job.process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            job.process.terminate()
