"""The life of the service under a real systemd as process 1."""

import os
import signal
import time
from pathlib import Path

import pytest

from tests.helpers.prom_diff import series_of_text
from tests.systemd.container import wait_until
from tests.systemd.service import START_LIMIT_S, UNIT, Service

pytestmark = pytest.mark.systemd

SCHED_OTHER, SCHED_FIFO = 0, 1


def watched_start(service: Service) -> list[tuple[str, int]]:
    """Start in the background; return what systemd and the daemon said of themselves meanwhile."""
    service.stop()
    service.container.check("systemctl", "start", "--no-block", UNIT)
    seen: list[tuple[str, int]] = []

    def is_over() -> bool:
        # first: it may become ready between the two
        state = service.show("ActiveState")
        seen.append((state, service.get("/readyz")[0]))
        return state in ("active", "failed")

    wait_until(is_over, START_LIMIT_S, "the service is ready or has failed")
    return seen


def test_active_means_that_the_first_ticks_met_their_deadlines(
    installed: Service,
) -> None:
    installed.start()  # compiles the kernels if nobody has done it here before
    seen = watched_start(installed)
    assert seen[-1] == ("active", 200), seen
    assert ("activating", 0) in seen
    assert "running: running" in installed.show("StatusText")
    assert installed.show("Type") == "notify"


def test_killed_and_restarted(service: Service) -> None:
    pid, restarts = service.main_pid, service.restarts
    os.kill(service.container.pid_here(pid), signal.SIGKILL)
    service.wait_restarted(pid)
    assert service.restarts == restarts + 1
    wait_until(lambda: service.get("/readyz")[0] == 200, 20, "it is ready")


@pytest.mark.parametrize(
    "victim", ["pacing thread", pytest.param("event loop", marks=pytest.mark.long)]
)
def test_one_frozen_thread_is_enough_for_the_watchdog(
    service: Service, victim: str
) -> None:
    pid, since = service.main_pid, service.container.cursor()
    is_plant = victim == "pacing thread"
    tid = service.pacing_thread().tid if is_plant else service.container.pid_here(pid)
    with service.frozen(tid):
        before = {thread.tid: thread.switches for thread in service.threads()}
        time.sleep(1.2)
        after = {thread.tid: thread.switches for thread in service.threads()}
        health, why = service.get("/healthz")
        service.wait_restarted(pid)
    assert after[tid] == before[tid]
    assert any(after[t] > before[t] for t in after if t != tid), (
        "the other threads live on"
    )
    # The event loop still answers, and says what is wrong; without it nobody answers.
    assert (health, "last woke up" in why) == (
        (503, True) if is_plant else (0, False)
    ), why
    assert "Watchdog timeout" in service.journal(since)
    wait_until(lambda: service.get("/readyz")[0] == 200, 20, "it is ready")


def test_reload_changes_what_can_change_and_names_what_cannot(service: Service) -> None:
    pid = service.main_pid
    try:
        since = service.container.cursor()
        service.configure(
            "logging: {level: DEBUG}\n"
            "scheduler: {limits: {single_overrun_ms: 900.0}}\n"
            "plant: {max_rpm: 80}\n"
        )
        service.container.check("systemctl", "reload", UNIT)
        wait_until(
            lambda: "max_rpm" in service.journal(since), 20, "the reload is logged"
        )
        said = {line.get("key"): line["event"] for line in service.lines(since)}
        assert said["logging.level"] == "reload: changed"
        assert said["scheduler.limits.single_overrun_ms"] == "reload: changed"
        assert said["plant.max_rpm"] == "reload: needs a restart, the old value stays"
        wait_until(lambda: service.show("SubState") == "running", 10, "the reload ends")

        since = service.container.cursor()
        service.configure("plant: {max_rmp: 80}\n")
        service.container.check("systemctl", "reload", UNIT)
        wait_until(
            lambda: "refused" in service.journal(since), 20, "the refusal is logged"
        )
        [line] = [line for line in service.lines(since) if "refused" in line["event"]]
        assert "config.yaml:2: unknown key 'plant.max_rmp'" in line["reason"]
    finally:
        service.configure("")
    assert service.is_active
    assert service.main_pid == pid
    wait_until(lambda: service.get("/readyz")[0] == 200, 20, "it is ready")


def test_a_wrong_configuration_fails_once(service: Service) -> None:
    service.stop()
    service.configure("plant: {max_rpm: fast}\n")
    try:
        since = service.container.cursor()
        assert service.container.run("systemctl", "start", UNIT).returncode != 0
        time.sleep(4)  # RestartSec is 2
        assert service.show("ActiveState") == "failed"
        assert service.show("ExecMainStatus") == "78"
        assert service.restarts == 0
        assert service.journal(since).count("'fast' is not valid") == 1
    finally:
        service.configure("")


def test_stop_is_clean(service: Service) -> None:
    image = service.container.path("/dev/shm/hilserver-robot")
    assert image.exists()
    service.stop()
    assert service.show("Result") == "success"
    assert service.show("ExecMainStatus") == "0"
    assert not image.exists()


def pacing_has_priority(service: Service) -> bool:
    """Whether it has SCHED_FIFO 80, and alone; if it has not, the audit has to name the reason."""
    pacing = service.pacing_thread()
    is_fifo = (pacing.policy, pacing.priority) == (SCHED_FIFO, 80)
    assert all(
        t.policy == SCHED_OTHER for t in service.threads() if t.tid != pacing.tid
    )
    series = series_of_text(service.get("/metrics")[1])
    audited = series["hil_audit_ok", frozenset({("item", "thread_priority")})]
    assert audited == is_fifo
    if not is_fifo:
        *_, named = [
            line["details"] for line in service.lines() if line["event"] == "degraded"
        ]
        assert named["thread_priority"]["found"] == "Operation not permitted"
        assert named["rtprio_limit"]["remedy"] or named["cgroup_cpu"]["remedy"]
    return is_fifo


def can_raise_limits() -> bool:
    """Whether this machine lets process 1 raise limits (CAP_SYS_RESOURCE)."""
    status = Path("/proc/self/status").read_text().splitlines()
    [line] = [line for line in status if line.startswith("CapEff:")]
    return bool(int(line.split()[1], 16) >> 24 & 1)


def test_the_pacing_thread_has_its_priority_or_the_audit_says_why_not(
    service: Service,
) -> None:
    assert pacing_has_priority(service) or not can_raise_limits()


def test_two_capabilities_do_where_limits_cannot_be_raised(service: Service) -> None:
    container = service.container
    folder = container.path(f"/etc/systemd/system/{UNIT}.d")
    folder.mkdir()
    container.check(
        "cp",
        "/opt/hilserver/source/deploy/systemd/capabilities.conf",
        f"/etc/systemd/system/{UNIT}.d/",
    )
    try:
        container.check("systemctl", "daemon-reload")
        container.check("systemctl", "restart", UNIT, timeout_s=START_LIMIT_S)
        assert pacing_has_priority(service)
        status = container.path(f"/proc/{service.main_pid}/status").read_text()
        assert "VmLck:\t       0 kB" not in status
    finally:
        (folder / "capabilities.conf").unlink()
        folder.rmdir()
        container.check("systemctl", "daemon-reload")
        service.stop()


def test_the_service_is_no_root_and_sees_no_home(service: Service) -> None:
    pid = service.container.pid_here(service.main_pid)
    assert Path(f"/proc/{pid}").stat().st_uid != 0
    assert not any(Path(f"/proc/{pid}/root/root").iterdir())
    os.kill(pid, signal.SIGTERM)
    wait_until(lambda: service.show("ActiveState") == "inactive", 20, "SIGTERM ends it")
    assert service.restarts == 0
