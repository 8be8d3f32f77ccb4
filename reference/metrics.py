"""The page of all metrics, written from their rows."""

from typing import Any

from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.daemon.metrics import METRICS
from hilserver.metrics import Metric, MetricKind

_INTRODUCTION = """\
# Metrics

Made from the rows of the code by `make reference`; a test keeps it up to date.

`http://127.0.0.1:9464/metrics` serves these names in Prometheus' text format, and in OpenMetrics to
clients that ask for it. All times are in seconds. A metric that has nothing to report (no peer, no
complete window yet) is absent rather than zero.

- Histograms have 1-2-5 buckets. Values below the first bound are in the first bucket,
  values above the last in `+Inf`.
- Counters and histograms count from the start of the process; `ResetStatistics` and reconnects do
  not reset them. `hil_margin_min_seconds` is a gauge and is reset.
- In the default configuration with one peer there are at most 300 series, the client library's own
  (`process_*`, `python_info`) included. A further peer adds about 60, a further slice about 22.
- Scrapes within 50 ms get the same answer: a flood of scrapes cannot keep the event loop busy.

| name | labels | kind | meaning |
|---|---|---|---|
"""

_HEALTH = """
## Health

| path | 200 when | else |
|---|---|---|
| `/healthz` | the pacing back end woke up within the last second, also while paused | 503 |
| `/readyz` | the state is running and the first ticks met their deadlines | 503 |

Both answer with a line of JSON: `{"ok": true, "state": "running", "reason": "..."}`.
"""


def _row(metric: Metric[Any]) -> str:
    labels = ", ".join(f"`{label}`" for label in metric.labels)
    kind = str(metric.kind)
    if metric.kind is MetricKind.HISTOGRAM:
        first, *_, last = (BOUNDS_NS[index] / 1e9 for index in metric.bound_indices)
        kind += f", {first:g} .. {last:g} s"
    return f"| `{metric.name}` | {labels} | {kind} | {metric.help} |\n"


def as_markdown() -> str:
    """Return the whole page."""
    return _INTRODUCTION + "".join(map(_row, METRICS)) + _HEALTH
