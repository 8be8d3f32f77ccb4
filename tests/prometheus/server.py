"""A real Prometheus with the shipped configuration, on loopback, in a hurry."""

import asyncio
import contextlib
import json
import math
import shutil
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from tests.helpers.daemons import free_port

DEPLOY = Path(__file__).parents[2] / "deploy" / "prometheus"
SCRAPE_S = 0.25
RATE_S = 1
START_LIMIT_S = 120.0

Series = dict[frozenset[tuple[str, str]], list[float]]


def missing() -> str:
    for tool in ("prometheus", "promtool"):
        if shutil.which(tool) is None:
            return f"{tool} is not installed: 'apt-get install prometheus' (make test does it)"
    return ""


def hurried(folder: Path, target: str) -> Path:
    """Write the shipped configuration with another target and short intervals."""
    config = yaml.safe_load((DEPLOY / "prometheus.yml").read_text(encoding="utf-8"))
    interval = f"{int(SCRAPE_S * 1000)}ms"
    config["global"] = {"scrape_interval": interval, "evaluation_interval": interval}
    config["rule_files"] = [str(DEPLOY / name) for name in config["rule_files"]]
    [job] = config["scrape_configs"]
    job["scrape_timeout"] = interval
    job["static_configs"] = [{"targets": [target]}]
    path = folder / "prometheus.yml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


@dataclass
class Prometheus:
    """A running server; times are those of `time.time`."""

    port: int

    def get(self, path: str, **parameters: object) -> dict:
        query = urllib.parse.urlencode(parameters)
        url = f"http://127.0.0.1:{self.port}/api/v1/{path}?{query}"
        with urllib.request.urlopen(url, timeout=10) as answer:
            return json.load(answer)["data"]

    def range(self, expression: str, start_s: float, end_s: float) -> Series:
        """Return the finite values of every series between two times."""
        data = self.get(
            "query_range", query=expression, start=start_s, end=end_s, step=SCRAPE_S
        )
        found: Series = {}
        for series in data["result"]:
            values = [float(value) for _, value in series["values"]]
            finite = [value for value in values if math.isfinite(value)]
            if finite:
                found[frozenset(series["metric"].items())] = finite
        return found

    def alerts(self) -> dict[str, str]:
        """Return the state (pending, firing) of every active alert."""
        return {
            a["labels"]["alertname"]: a["state"] for a in self.get("alerts")["alerts"]
        }

    def target_is_up(self) -> bool:
        return [t["health"] for t in self.get("targets")["activeTargets"]] == ["up"]


@contextlib.contextmanager
def running_prometheus(folder: Path, target: str) -> Iterator[Prometheus]:
    server = Prometheus(free_port())
    command = [
        "prometheus",
        f"--config.file={hurried(folder, target)}",
        f"--storage.tsdb.path={folder / 'data'}",
        f"--web.listen-address=127.0.0.1:{server.port}",
        "--log.level=warn",
    ]
    with (folder / "prometheus.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log
        )
        try:
            yield server
        finally:
            process.terminate()
            process.wait(20)


async def until(condition: Callable[[], object], limit_s: float, what: str) -> float:
    """Ask in a thread, so that the daemon of this process goes on; return how long it took."""
    started_s = time.monotonic()
    while True:
        with contextlib.suppress(OSError):
            if await asyncio.to_thread(condition):
                return time.monotonic() - started_s
        assert time.monotonic() - started_s < limit_s, f"not within {limit_s} s: {what}"
        await asyncio.sleep(SCRAPE_S)
