"""Rules and alerts: promtool accepts them, their unit tests pass, each alert has its runbook."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from hilserver.daemon.metrics import METRICS
from tests.prometheus.server import DEPLOY, missing

pytestmark = pytest.mark.prometheus

ROOT = Path(__file__).parents[2]
TESTS = Path(__file__).with_name("rules.test.yml")


def load(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def rules() -> list[dict]:
    files = load(DEPLOY / "prometheus.yml")["rule_files"]
    return [
        r
        for name in files
        for group in load(DEPLOY / name)["groups"]
        for r in group["rules"]
    ]


ALERTS = {rule["alert"]: rule for rule in rules() if "alert" in rule}


def promtool(*words: str) -> str:
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    done = subprocess.run(
        ["promtool", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_promtool_accepts_configuration_and_rules() -> None:
    promtool("check", "config", str(DEPLOY / "prometheus.yml"))
    promtool(
        "check",
        "rules",
        *map(str, DEPLOY.glob("*.rules.yml")),
        *map(str, DEPLOY.glob("*.alerts.yml")),
    )


def test_the_unit_tests_of_the_rules_pass() -> None:
    assert "SUCCESS" in promtool("test", "rules", str(TESTS))


def test_every_alert_is_tested_firing_and_quiet() -> None:
    tests = load(TESTS)["tests"]
    cases = [case for test in tests for case in test["alert_rule_test"]]
    firing = {case["alertname"] for case in cases if case["exp_alerts"]}
    quiet = {case["alertname"] for case in cases if not case["exp_alerts"]}
    assert firing == quiet == set(ALERTS)


def test_every_alert_has_its_page_and_every_page_its_alert() -> None:
    pages = {path.stem for path in (ROOT / "docs" / "runbooks").glob("Hilserver*.md")}
    assert pages == set(ALERTS)
    for name, rule in ALERTS.items():
        assert rule["annotations"]["runbook_url"] == f"docs/runbooks/{name}.md"
        text = (ROOT / "docs" / "runbooks" / f"{name}.md").read_text(encoding="utf-8")
        assert text.startswith(f"# {name}\n")
        for heading in ("## What it means", "## What to look at", "## What helps"):
            assert heading in text, name


@pytest.mark.parametrize("rule", rules(), ids=lambda r: r.get("alert") or r["record"])
def test_rules_use_metrics_that_exist(rule: dict) -> None:
    recorded = {r["record"] for r in rules() if "record" in r}
    names = {metric.name for metric in METRICS}
    used = set(
        re.findall(r"(?<![\w:])(?:[a-z_]+:)?hil_[a-z0-9_]+(?::\w+)?", rule["expr"])
    )
    known = names | {f"{name}_bucket" for name in names} | recorded
    assert used <= known
    assert used or "up{" in rule["expr"]
