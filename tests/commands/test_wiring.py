"""Commissioning against the embedded controller in a process; what each mistake is called."""

import asyncio
import time
from types import SimpleNamespace

import pytest

from hilserver.commands import main, wiring
from hilserver.commands.demo import running_controller
from hilserver.commands.wiring import WheelCheck, as_table, complaint
from hilserver.config.root import Config
from hilserver.controller.nodes import demo_peer, node_id
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon

QUIET = "opcua: {enabled: false}\nmetrics: {enabled: false}\nimage: {name: auto}\n"


@pytest.mark.parametrize(
    ("wheel", "wanted", "moving", "words"),
    [
        ("fl", 20, {"fl": 20.0}, ""),
        ("fr", -20, {"fr": -20.3}, ""),
        ("fl", 20, {"rl": 20.0}, "order: rear left instead of front left"),
        ("fl", 20, {"fr": -20.0}, "side: front right instead of front left"),
        (
            "fl",
            20,
            {"fl": -20.0},
            "sign: forward is positive on the left, negative on the right",
        ),
        ("fl", 20, {"fl": 2.094}, "unit: 0.1047 times too large, rad/s instead of rpm"),
        ("fl", 20, {"fl": 26.0}, "unit: 1.3 times too large"),
        ("fl", 20, {"fl": 20.0, "rr": 1.0}, "not alone: fl, rr move"),
        ("fl", 20, {}, "it moved too briefly to be measured"),
        (
            "fl",
            20,
            {"fr": 2.094},
            "side: front right instead of front left; sign: forward is positive on the left,"
            " negative on the right; unit: 0.1047 times too large, rad/s instead of rpm",
        ),
    ],
)
def test_each_mistake_has_its_words(wheel, wanted, moving, words):
    assert complaint(wheel, wanted, moving) == words


def test_the_right_wiring_passes(tmp_path, capsys):
    config = tmp_path / "config.yaml"
    config.write_text(QUIET)
    assert main(["wiring", "-c", str(config), "--demo", "--timeout", "20"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()] == [
        *("what", "fl", "rl", "fr", "rr", "stale")
    ]
    assert out.count("  ok\n") == 5


async def test_swapped_wheels_a_wrong_sign_and_the_stale_time_are_seen(monkeypatch):
    base = assemble_config(Config.model_validate({"image": {"name": "auto"}}))
    async with running_controller(base.robot, pattern="wheels") as endpoint:
        peer = demo_peer(endpoint)
        read = dict(peer.read)
        front, rear = node_id("rpm_set_FL"), node_id("rpm_set_RL")
        read[front], read[rear] = read[rear], read[front]
        peer = peer.model_copy(update={"read": read, "stale_after_ms": 300.0})
        config = base.config.model_copy(
            update={
                "peers": (peer,),
                "opcua": base.config.opcua.model_copy(update={"enabled": False}),
                "metrics": base.config.metrics.model_copy(update={"enabled": False}),
            }
        )
        async with Daemon(assemble_config(config)) as daemon:
            daemon.faults.inject(
                {"fault": "scale", "signal": "wheel.rr.setpoint_rpm", "factor": -1}
            )
            check = WheelCheck(daemon, peer.name, 20.0, 15.0, lambda _: None)
            inject, loop = daemon.faults.inject, asyncio.get_running_loop()

            def inject_on_a_busy_computer(fault):
                inject(fault)
                loop.call_later(0.05, time.sleep, 0.6)

            monkeypatch.setattr(daemon.faults, "inject", inject_on_a_busy_computer)
            findings = await check.check()
    assert [f.complaint for f in findings] == [
        "order: rear left instead of front left",
        "order: front left instead of rear left",
        "",
        "sign: forward is positive on the left, negative on the right",
        "",
    ], as_table(findings)
    assert "busy" in findings[-1].arrived


@pytest.mark.parametrize("gap_looks", [10, 120])
async def test_a_wheel_counts_once_it_turns_steadily(monkeypatch, gap_looks):
    """A controller with a ramp, and one whose command comes late and leaves a gap."""
    ramp = [{}, *({"fl": rpm / 5} for rpm in range(1, 100))]
    steady = [{"fl": 20.0}] * 10
    moving = iter([*ramp, *steady, *[{}] * gap_looks])
    now_s = 0.0

    async def sleep(delay_s):
        nonlocal now_s
        now_s += delay_s

    monkeypatch.setattr(wiring, "asyncio", SimpleNamespace(sleep=sleep))
    clock = SimpleNamespace(monotonic=lambda: now_s)
    monkeypatch.setattr(wiring, "time", clock)
    check = object.__new__(WheelCheck)
    check._speed_rpm, check._timeout_s = 20.0, 15.0
    monkeypatch.setattr(check, "_moving", lambda: next(moving, {"fl": 20.0}))
    finding = await check._wheel("fl")
    assert (finding.arrived, finding.complaint) == ("fl +20 rpm", "")


def test_without_a_peer_it_says_what_to_do(tmp_path, capsys):
    config = tmp_path / "config.yaml"
    config.write_text(QUIET)
    assert main(["wiring", "-c", str(config)]) == 78
    assert "there is no peer to check" in capsys.readouterr().err
