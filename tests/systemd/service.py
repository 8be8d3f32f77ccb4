"""The installed service in its container, as an operator handles it."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.daemons import NO_LIMITS
from tests.systemd.container import PYTHON, Container, wait_until

UNIT = "hilserver.service"
CONFIG = "/etc/hilserver/config.yaml"
GOOD = "snapshots: {folder: /var/lib/hilserver/snapshots}\n"
START_LIMIT_S = 280
_GET = """
import sys, urllib.request, urllib.error
try:
    answer = urllib.request.urlopen("http://127.0.0.1:9464" + sys.argv[1], timeout=1)
except urllib.error.HTTPError as error:
    answer = error
except OSError as error:
    sys.exit(str(error))
print(answer.status)
print(answer.read().decode())
"""


@dataclass(frozen=True)
class Thread:
    """A thread as the kernel schedules it."""

    tid: int
    policy: int
    priority: int
    switches: int


@dataclass
class Service:
    container: Container

    @classmethod
    def install(cls, container: Container) -> "Service":
        container.check(PYTHON, "-m", "hilserver", "install-service")
        return cls(container)

    def start(self) -> None:
        """Start if it does not run; return when systemd has heard READY=1."""
        self.container.run("systemctl", "reset-failed", UNIT)
        self.container.check("systemctl", "start", UNIT, timeout_s=START_LIMIT_S)

    def stop(self) -> None:
        self.container.check("systemctl", "stop", UNIT)

    def configure(self, text: str) -> None:
        limits = "" if "scheduler:" in text else NO_LIMITS
        self.container.path(CONFIG).write_text(GOOD + text + limits, encoding="utf-8")

    def show(self, key: str) -> str:
        return self.container.show(UNIT, key)

    @property
    def is_active(self) -> bool:
        return self.show("ActiveState") == "active"

    @property
    def main_pid(self) -> int:
        return int(self.show("MainPID"))

    @property
    def restarts(self) -> int:
        return int(self.show("NRestarts"))

    def journal(self, since: str = "") -> str:
        return self.container.journal(UNIT, since)

    def lines(self, since: str = "") -> list[dict]:
        """Return the daemon's own log lines."""
        text = self.journal(since)
        return [json.loads(line) for line in text.splitlines() if line.startswith("{")]

    def get(self, path: str) -> tuple[int, str]:
        """Return status and body of an answer of the daemon; 0 when nobody answers."""
        done = self.container.run("/usr/bin/python3", "-c", _GET, path)
        if done.returncode != 0:
            return 0, done.stderr
        status, _, body = done.stdout.partition("\n")
        return int(status), body

    def wait_restarted(self, old_pid: int, limit_s: float = 60) -> float:
        def restarted() -> bool:
            return self.is_active and self.main_pid not in (0, old_pid)

        return wait_until(restarted, limit_s, "systemd restarts the service")

    def threads(self) -> list[Thread]:
        """Return the threads of the daemon, by their numbers on the host."""
        pid = self.container.pid_here(self.main_pid)
        found = []
        for task in Path(f"/proc/{pid}/task").iterdir():
            fields = (task / "stat").read_text().rpartition(")")[2].split()
            status = dict(
                line.split(":", 1)
                for line in (task / "status").read_text().splitlines()
            )
            switches = int(status["voluntary_ctxt_switches"])
            found.append(
                Thread(int(task.name), int(fields[38]), int(fields[37]), switches)
            )
        return found

    def pacing_thread(self) -> Thread:
        """Return the thread that sleeps a thousand times a second."""
        before = {thread.tid: thread.switches for thread in self.threads()}
        time.sleep(1.0)
        after = self.threads()
        busiest = max(after, key=lambda t: t.switches - before.get(t.tid, t.switches))
        assert busiest.switches - before[busiest.tid] > 300, "no thread is paced"
        return busiest

    @contextlib.contextmanager
    def frozen(self, tid: int) -> Iterator[None]:
        """Stop one thread of the daemon; the daemon has to end before the context does."""
        freezer = Path(__file__).with_name("freezer.py")
        command = [sys.executable, str(freezer), str(tid)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == "frozen\n"
                yield
                assert process.wait(600) == 0
            finally:
                process.kill()
