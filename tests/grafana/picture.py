"""Draws the dashboard, panel by panel, as its file says, with what a real Prometheus answers.

``python -m tests.grafana.picture FILE`` lets the demonstration drive for a minute and a half; where
ticks were missed meanwhile, nothing is saved. It is no Grafana, whose server no registry here has:
places, titles, queries, units and kinds of panels are the dashboard's, the rest is matplotlib's.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

from matplotlib import pyplot as plt
from matplotlib.colors import PowerNorm

from tests.helpers.daemons import NO_LIMITS, running_daemon
from tests.prometheus.server import running_prometheus

DASHBOARD = (
    Path(__file__).parents[2] / "deploy" / "grafana" / "dashboards" / "hilserver.json"
)
WINDOW_S, STEP_S, RATE = 80, 1, "4s"
COLUMNS, CELL_INCH = 24, 0.34
PAPER, PANEL, INK = "#111217", "#181b1f", "#ccccdc"
COLOURS = {"green": "#73bf69", "orange": "#ff9830", "red": "#f2495c", "blue": "#5794f2"}
MOST_NAMES = 6
MISSED = f"sum(increase(hil_missed_ticks_total[{WINDOW_S}s]))"


def asked(expression):
    """Return a query as Grafana would send it for all daemons."""
    known = {"$instance": ".*", "$__rate_interval": RATE, "$__range": f"{WINDOW_S}s"}
    for name, value in known.items():
        expression = expression.replace(name, value)
    return expression


def series_of(panel, prometheus, end_s):
    """Return names, times [s] and values of what a panel's queries answer."""
    found = []
    for target in panel["targets"]:
        answer = prometheus.get(
            "query_range",
            query=asked(target["expr"]),
            start=end_s - WINDOW_S,
            end=end_s,
            step=STEP_S,
        )
        for series in answer["result"]:
            name = target["legendFormat"]
            for label, value in series["metric"].items():
                name = name.replace(f"{{{{{label}}}}}", value)
            points = [(float(t) - end_s, float(value)) for t, value in series["values"]]
            found.append((name, *zip(*points, strict=True)))
    return found


def shown(value, unit):
    """Return a number as Grafana writes it, in short."""
    if unit == "s":
        for scale, name in ((1, "s"), (1e3, "ms"), (1e6, "µs")):
            if abs(value) * scale >= 1 or name == "µs":
                return f"{value * scale:.3g} {name}"
    if unit in ("bytes", "decbytes"):
        return f"{value / 2**20:.5g} MiB"
    return f"{value:.6g}"


def draw_stat(axes, panel, series):
    """Draw the newest value, or the name where the panel asks for that."""
    is_name = panel["options"]["textMode"] == "name"
    name, _, values = series[-1]
    defaults = panel["fieldConfig"]["defaults"]
    text = name if is_name else shown(values[-1], defaults["unit"])
    steps = defaults["thresholds"]["steps"]
    reached = [
        s["color"] for s in steps if s["value"] is None or values[-1] >= s["value"]
    ]
    axes.text(
        0.5, 0.45, text, color=COLOURS[reached[-1]], size=17, ha="center", va="center"
    )
    axes.set_axis_off()


def draw_timeseries(axes, panel, series):
    """Draw lines, and the names of the first ones."""
    unit = panel["fieldConfig"]["defaults"]["unit"]
    for name, times, values in series:
        axes.plot(times, values, lw=0.9, label=name)
    axes.yaxis.set_major_formatter(lambda value, _: shown(value, unit))
    handles, names = (each[:MOST_NAMES] for each in axes.get_legend_handles_labels())
    look = {"fontsize": 5, "frameon": False, "labelcolor": INK}
    axes.legend(handles, names, loc="upper left", ncols=2, **look)


def draw_heatmap(axes, panel, series):
    """Draw counts per bucket and time; the buckets are cumulative."""
    rows = sorted(series, key=lambda row: float(row[0]))
    times = sorted({t for _, ts, _ in rows for t in ts})
    counts = [
        [dict(zip(ts, vs, strict=True)).get(t, 0.0) for t in times]
        for _, ts, vs in rows
    ]
    per_bucket = [
        [max(0.0, high - low) for high, low in zip(row, below, strict=True)]
        for row, below in zip(counts, [[0.0] * len(times), *counts], strict=False)
    ]
    axes.pcolormesh(
        times, range(len(rows)), per_bucket, cmap="turbo", norm=PowerNorm(0.4)
    )
    axes.set_yticks(
        range(0, len(rows), 3),
        [shown(float(rows[i][0]), "s") for i in range(0, len(rows), 3)],
    )


def draw_state_timeline(axes, panel, series):
    """Draw a bar per series where it has a value; green is 1."""
    names = list(dict.fromkeys(name for name, *_ in series))
    for name, times, values in series:
        for begin, value in zip(times, values, strict=True):
            colour = COLOURS["green" if value else "red"]
            axes.barh(names.index(name), STEP_S, left=begin, height=0.8, color=colour)
    axes.set_yticks(range(len(names)), names)
    axes.set_xlim(-WINDOW_S, 0)


DRAW = {
    "stat": draw_stat,
    "timeseries": draw_timeseries,
    "heatmap": draw_heatmap,
    "state-timeline": draw_state_timeline,
}


def draw(dashboard, answer):
    """Return the figure; `answer` gives the series of a panel."""
    height = max(p["gridPos"]["y"] + p["gridPos"]["h"] for p in dashboard["panels"])
    figure = plt.figure(
        figsize=(COLUMNS * CELL_INCH * 1.6, height * CELL_INCH), facecolor=PAPER
    )
    for panel in dashboard["panels"]:
        x, y, w, h = (panel["gridPos"][key] for key in "xywh")
        left, top = x / COLUMNS, 1 - y / height
        if panel["type"] == "row":
            figure.text(
                left + 0.005, top - 0.6 / height, panel["title"], color=INK, size=10
            )
            continue
        box = (
            left + 0.002,
            top - (h - 0.15) / height,
            w / COLUMNS - 0.004,
            (h - 0.3) / height,
        )
        frame = figure.add_axes(box, facecolor=PANEL)
        frame.set(xticks=[], yticks=[])
        frame.set_title(
            panel["title"], color=INK, size=7, loc="left", x=0.01, y=1.0, pad=-9
        )
        x0, y0, wide, high = box
        room = min(0.08 if panel["type"] == "state-timeline" else 0.05, wide / 4)
        inner = (x0 + room, y0 + 0.7 / height, wide - room - 0.01, high - 2.0 / height)
        axes = figure.add_axes(inner, facecolor=PANEL)
        axes.tick_params(colors=INK, labelsize=5)
        if series := answer(panel):
            DRAW[panel["type"]](axes, panel, series)
        else:
            axes.text(0.5, 0.5, "No data", color=INK, size=9, ha="center", va="center")
            axes.set_axis_off()
        for spine in (*frame.spines.values(), *axes.spines.values()):
            spine.set_color("#2c3235")
    return figure


def refuse_starved(answer):
    """End where the answer to `MISSED` says that the computer had other work."""
    missed = sum(float(series["value"][1]) for series in answer)
    if missed > 0:
        sys.exit(
            f"no picture is saved, {missed:.0f} ticks were missed in {WINDOW_S} s: close what else"
            " runs on this computer and try again"
        )


def main(out):
    """Let the demonstration drive, and draw."""
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with running_daemon(folder, "--demo", config=NO_LIMITS) as daemon:
            target = daemon.metrics_url.split("/")[2]
            with running_prometheus(folder, target) as prometheus:
                time.sleep(WINDOW_S + 10)
                end_s = time.time()
                refuse_starved(
                    prometheus.get("query", query=MISSED, time=end_s)["result"]
                )
                figure = draw(
                    dashboard, lambda panel: series_of(panel, prometheus, end_s)
                )
    figure.savefig(out, dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
