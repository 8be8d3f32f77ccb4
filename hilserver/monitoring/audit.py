"""The real-time audit: what this system grants to a paced thread, and what it lacks.

Every item is a pure function of the files of /proc, /sys and /dev below a root, so that it can be
tested on a tree of its own. Missing items make the figures worse and are shown in the log, in a
metric and in OPC UA, but never stop the daemon.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hilserver.metrics import gauges
from hilserver.scheduler.realtime import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    AuditFinding,
    has_capability,
)

if TYPE_CHECKING:
    from hilserver.scheduler import Scheduler

_GOOD_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock")


def audit(scheduler: "Scheduler", root: Path = Path("/")) -> list[AuditFinding]:
    """Return what the system offers, then what it granted to this scheduler."""
    items = [check(root) for check in CHECKS]
    # Reading another thread's slack needs privileges: prefer the value from the thread itself.
    if all(grant.name != "timer_slack" for grant in scheduler.grants):
        items.append(timer_slack(root, scheduler.thread_id))
    return items + scheduler.grants


def kernel(root: Path) -> AuditFinding:
    """Check for a PREEMPT_RT kernel."""
    version = _read(root, "proc/version")
    is_rt = _read(root, "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version
    kind = next(
        (k for k in ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT") if k in version),
        "plain",
    )
    return _item(
        "kernel", is_rt, kind, "PREEMPT_RT", "install a kernel with PREEMPT_RT"
    )


def governor(root: Path) -> AuditFinding:
    """Check that the cores keep their clock frequency."""
    paths = sorted(
        root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    )
    found = sorted({path.read_text(encoding="ascii").strip() for path in paths})
    ok = found in ([], ["performance"])
    text = ", ".join(found) or "none (not scaled by this system)"
    return _item(
        "governor", ok, text, "performance", "cpupower frequency-set -g performance"
    )


def isolated_cores(root: Path) -> AuditFinding:
    """Check that a core is kept free of other work."""
    isolated = _read(root, "sys/devices/system/cpu/isolated")
    remedy = "boot with isolcpus=N nohz_full=N and set scheduler.realtime.cpu to N"
    return _item(
        "isolated_cores", bool(isolated), isolated or "none", "at least one", remedy
    )


def rtprio_limit(root: Path) -> AuditFinding:
    """Check that a thread of this process may have a real-time priority."""
    if has_capability(CAP_SYS_NICE, root):
        return _item(
            "rtprio_limit", True, "CAP_SYS_NICE", "LimitRTPRIO or CAP_SYS_NICE", ""
        )
    limit = _limit(root, "Max realtime priority")
    remedy = "LimitRTPRIO=95 in the unit, or ulimit -r 95"
    wanted = "LimitRTPRIO, CAP_SYS_NICE"
    return _item("rtprio_limit", limit not in ("0", "?"), limit, wanted, remedy)


def memlock_limit(root: Path) -> AuditFinding:
    """Check that this process may lock its memory."""
    if has_capability(CAP_IPC_LOCK, root):
        return _item(
            "memlock_limit", True, "CAP_IPC_LOCK", "unlimited or CAP_IPC_LOCK", ""
        )
    limit = _limit(root, "Max locked memory")
    remedy = "LimitMEMLOCK=infinity in the unit, or ulimit -l unlimited"
    return _item(
        "memlock_limit", limit == "unlimited", limit, "unlimited, CAP_IPC_LOCK", remedy
    )


def clock_source(root: Path) -> AuditFinding:
    """Check that the clock is read without a system call."""
    path = "sys/devices/system/clocksource/clocksource0/current_clocksource"
    found = _read(root, path) or "unknown"
    return _item(
        "clock_source", found in _GOOD_CLOCKS, found, "tsc", "boot with tsc=reliable"
    )


def cpu_dma_latency(root: Path) -> AuditFinding:
    """Check that the cores are kept from sleeping deeply."""
    try:
        with (root / "dev/cpu_dma_latency").open("rb") as device:
            target_us = int.from_bytes(device.read(4), "little", signed=True)
    except OSError as error:
        found = error.strerror or "not readable"
        remedy = "give the user access to /dev/cpu_dma_latency (a udev rule)"
        return _item("cpu_dma_latency", False, found, "0 us", remedy)
    remedy = "set scheduler.realtime.hold_latency_target to true"
    return _item("cpu_dma_latency", target_us == 0, f"{target_us} us", "0 us", remedy)


def cgroup_cpu(root: Path) -> AuditFinding:
    """Check that the control group restricts neither time nor real-time priority."""
    wanted = "no quota, real-time allowed"
    for line in _read(root, "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if "cpu" in controllers.split(","):
            folder = next(
                iter(root.glob(f"sys/fs/cgroup/cpu*{path}")), root / "nowhere"
            )
            quota_us = _read(folder, "cpu.cfs_quota_us")
            if quota_us and not quota_us.startswith("-"):
                found = f"quota {quota_us} {_read(folder, 'cpu.cfs_period_us')}"
                return _item("cgroup_cpu", False, found, wanted, "remove CPUQuota")
            runtime = _read(folder, "cpu.rt_runtime_us")
            if runtime == "0":
                remedy = "give the group cpu.rt_runtime_us, or run in the root group"
                return _item("cgroup_cpu", False, "no real-time budget", wanted, remedy)
        if not controllers:
            quota = _read(root, f"sys/fs/cgroup{path}/cpu.max")
            if quota and not quota.startswith("max"):
                return _item(
                    "cgroup_cpu", False, f"quota {quota}", wanted, "remove CPUQuota"
                )
    return _item("cgroup_cpu", True, wanted, wanted, "")


def virtualised(root: Path) -> AuditFinding:
    """Check that there is no hypervisor between this system and the cores."""
    in_vm = any(
        "hypervisor" in line.split()
        for line in _read(root, "proc/cpuinfo").splitlines()
        if line.startswith("flags")
    )
    found = "a virtual machine" if in_vm else "no hypervisor detected"
    remedy = "run on bare metal: a hypervisor takes time away"
    return _item("virtualised", not in_vm, found, "bare metal", remedy)


def swap(root: Path) -> AuditFinding:
    """Check that no memory can be swapped to a disk."""
    devices = [line.split()[0] for line in _read(root, "proc/swaps").splitlines()[1:]]
    return _item(
        "swap", not devices, ", ".join(devices) or "none", "none", "swapoff -a"
    )


def timer_slack(root: Path, thread_id: int) -> AuditFinding:
    """Check how far the kernel may delay the pacing thread's timers (real-time: 0)."""
    found = _read(root, f"proc/{thread_id or 'self'}/timerslack_ns")
    ok = found.isdigit() and int(found) <= 1
    text = f"{found} ns" if found else "unknown"
    return _item(
        "timer_slack", ok, text, "at most 1 ns", "pace with scheduler.backend: thread"
    )


CHECKS: tuple[Callable[[Path], AuditFinding], ...] = (
    kernel,
    governor,
    isolated_cores,
    rtprio_limit,
    memlock_limit,
    clock_source,
    cpu_dma_latency,
    cgroup_cpu,
    virtualised,
    swap,
)


METRICS: Final = gauges(
    "hil_audit_ok",
    "1 if the system fulfils this item of the real-time audit, else 0.",
    "item",
)


def as_lines(items: Sequence[AuditFinding]) -> list[str]:
    """Return the audit as lines of text for a terminal."""
    lines = []
    for item in items:
        lines.append(
            f"{'ok     ' if item.ok else 'missing'} {item.name:20} {item.found}"
        )
        if not item.ok:
            lines[-1] += (
                f" (wanted: {item.wanted}{'; ' if item.remedy else ''}{item.remedy})"
            )
    return lines


def _item(name: str, ok: bool, found: str, wanted: str, remedy: str) -> AuditFinding:
    return AuditFinding(name, ok, found, wanted, "" if ok else remedy)


def _read(root: Path, path: str) -> str:
    """Return a file's text without surrounding space; empty if there is none."""
    try:
        return (root / path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _limit(root: Path, name: str) -> str:
    """Return a soft limit of /proc/self/limits, ``?`` if unknown."""
    for line in _read(root, "proc/self/limits").splitlines():
        if line.startswith(name):
            return line[len(name) :].split()[0]
    return "?"
