"""The dashboard against Grafana's own schema, and what a schema cannot say."""

import copy
import json
import re
import shutil
import subprocess
from itertools import combinations
from pathlib import Path

import pytest
import yaml
from matplotlib import pyplot as plt

from hilserver.daemon.metrics import METRICS
from tests.grafana.picture import draw, refuse_starved

HERE = Path(__file__).parent
GRAFANA = HERE.parents[1] / "deploy" / "grafana"
DASHBOARD = json.loads(
    (GRAFANA / "dashboards" / "hilserver.json").read_text(encoding="utf-8")
)
PANELS = [panel for panel in DASHBOARD["panels"] if panel["type"] != "row"]
INSTALL = "npm install --no-audit --no-fund --prefix tests/grafana"


def complaints(dashboard: dict, folder: Path) -> str:
    """Return what the TypeScript compiler says of the dashboard; empty: it fits."""
    modules = HERE / "node_modules"
    if not (modules / "@grafana" / "schema").is_dir() or not shutil.which("node"):
        pytest.fail(
            f"Grafana's schema is not installed: run '{INSTALL}'", pytrace=False
        )
    (folder / "node_modules").symlink_to(modules)
    panels = [panel for panel in dashboard["panels"] if panel["type"] != "row"]

    def fill(match: re.Match[str]) -> str:
        what, _, kind = match[1].partition(":")
        of_kind = [panel for panel in panels if panel["type"] == kind]
        if what == "DASHBOARD":
            return json.dumps(dashboard)
        if what == "TARGETS":
            return json.dumps(
                [target for panel in panels for target in panel["targets"]]
            )
        if what == "OPTIONS":
            return json.dumps([panel["options"] for panel in of_kind])
        return json.dumps(
            [panel["fieldConfig"]["defaults"]["custom"] for panel in of_kind]
        )

    template = (HERE / "schema.ts.in").read_text(encoding="utf-8")
    source = folder / "dashboard.ts"
    source.write_text(
        re.sub(r"@(DASHBOARD|TARGETS|OPTIONS:[a-z-]+|CUSTOM:[a-z-]+)@", fill, template)
    )
    options = (
        "--noEmit --strict --skipLibCheck --target es2022 "
        "--module esnext --moduleResolution node"
    )
    done = subprocess.run(
        ["node", str(modules / "typescript/bin/tsc"), *options.split(), str(source)],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=folder,
        check=False,
    )
    assert (done.returncode == 0) == (not done.stdout), done.stdout + done.stderr
    return done.stdout


def test_the_dashboard_fits_grafanas_schema(tmp_path: Path) -> None:
    assert not complaints(DASHBOARD, tmp_path)


def test_the_schema_notices_mistakes(tmp_path: Path) -> None:
    wrong = copy.deepcopy(DASHBOARD)
    panels = [panel for panel in wrong["panels"] if panel["type"] != "row"]
    panels[0]["options"]["colorMode"] = "foreground"
    next(p for p in panels if p["type"] == "heatmap")["options"]["yAxis"]["unitt"] = "s"
    panels[1]["targets"][0]["query"] = "up"
    panels[2]["fieldConfig"]["defaults"]["thresholds"]["mode"] = "relative"
    said = complaints(wrong, tmp_path)
    for mistake in ('"foreground"', '"unitt"', '"query"', '"relative"'):
        assert mistake in said, said


def test_the_schema_notices_unknown_keys(tmp_path: Path) -> None:
    assert '"graphToltip"' in complaints({**DASHBOARD, "graphToltip": 1}, tmp_path)


def test_panels_have_their_own_place_and_number() -> None:
    ids = [panel["id"] for panel in DASHBOARD["panels"]]
    assert len(set(ids)) == len(ids)
    for one, other in combinations((p["gridPos"] for p in DASHBOARD["panels"]), 2):
        apart_x = (
            one["x"] + one["w"] <= other["x"] or other["x"] + other["w"] <= one["x"]
        )
        apart_y = (
            one["y"] + one["h"] <= other["y"] or other["y"] + other["h"] <= one["y"]
        )
        assert apart_x or apart_y, (one, other)
    assert all(p["gridPos"]["x"] + p["gridPos"]["w"] <= 24 for p in DASHBOARD["panels"])


def test_every_metric_is_on_the_dashboard() -> None:
    queries = " ".join(t["expr"] for panel in PANELS for t in panel["targets"])
    variables = " ".join(str(v["query"]) for v in DASHBOARD["templating"]["list"])
    # flat for months: an alert would say it, no picture
    for_the_soak = {"hil_asyncio_tasks"}
    shown = queries + variables
    missing = [
        m.name for m in METRICS if m.name not in shown and m.name not in for_the_soak
    ]
    assert not missing


def test_every_panel_says_what_it_shows() -> None:
    assert all(panel["description"].endswith(".") for panel in PANELS)
    assert {panel["type"] for panel in PANELS} == {
        "stat",
        "timeseries",
        "heatmap",
        "state-timeline",
    }


def test_provisioning_names_the_files_and_the_interval_of_the_scrapes() -> None:
    def load(path: str) -> dict:
        return yaml.safe_load((GRAFANA / path).read_text(encoding="utf-8"))

    [source] = load("provisioning/datasources/hilserver.yaml")["datasources"]
    scrapes = load("../prometheus/prometheus.yml")["global"]["scrape_interval"]
    assert source["type"] == "prometheus"
    assert source["jsonData"]["timeInterval"] == scrapes
    [provider] = load("provisioning/dashboards/hilserver.yaml")["providers"]
    assert provider["type"] == "file"


def test_every_panel_can_be_drawn() -> None:
    def answer(panel: dict) -> list:
        if panel["title"] == "Model gap":  # nobody measures
            return []
        return [
            ("0.001", (-2.0, -1.0), (0.0, 1.0)),
            ("0.002", (-2.0, -1.0), (0.0, 3.0)),
        ]

    figure = draw(DASHBOARD, answer)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title for title in titles if title] == [panel["title"] for panel in PANELS]
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert texts.count("No data") == 1
    plt.close(figure)


def test_a_picture_with_missed_ticks_is_not_saved() -> None:
    refuse_starved([])
    refuse_starved([{"value": [0.0, "0"]}])
    with pytest.raises(
        SystemExit, match="no picture is saved, 12 ticks were missed in 80 s"
    ):
        refuse_starved([{"value": [0.0, "12.2"]}])
