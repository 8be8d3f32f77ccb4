"""The audit on trees of its own: a system tuned for real time, and one that is not."""

from dataclasses import dataclass, field

import pytest

from hilserver.monitoring import audit as au
from hilserver.scheduler.realtime import AuditFinding

TUNED = {
    "proc/version": "Linux version 6.12.0-rt5 (gcc) #1 SMP PREEMPT_RT",
    "sys/kernel/realtime": "1",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/isolated": "3",
    "proc/self/limits": "Max realtime priority     95   95\nMax locked memory         unlimited\n",
    "proc/self/status": "Name:\thilserver\nCapEff:\t0000000000000000\n",
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
    "dev/cpu_dma_latency": "\0\0\0\0",
    "proc/self/cgroup": "0::/system.slice/hilserver.service",
    "sys/fs/cgroup/system.slice/hilserver.service/cpu.max": "max 100000",
    "proc/cpuinfo": "processor : 0\nflags : fpu sse2 avx\n",
    "proc/swaps": "Filename Type Size Used Priority",
    "proc/42/timerslack_ns": "0",
}
# What is changed, and the item that must notice it.
SPOILED = [
    ({"proc/version": "#1 SMP PREEMPT_DYNAMIC", "sys/kernel/realtime": "0"}, "kernel"),
    ({"sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "powersave"}, "governor"),
    ({"sys/devices/system/cpu/isolated": ""}, "isolated_cores"),
    (
        {
            "proc/self/limits": "Max realtime priority 0 0\nMax locked memory unlimited\n"
        },
        "rtprio_limit",
    ),
    (
        {
            "proc/self/limits": "Max realtime priority 9 9\nMax locked memory 8388608 8388608\n"
        },
        "memlock_limit",
    ),
    (
        {"sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet"},
        "clock_source",
    ),
    ({"dev/cpu_dma_latency": "\1\0\0\0"}, "cpu_dma_latency"),
    (
        {"sys/fs/cgroup/system.slice/hilserver.service/cpu.max": "50000 100000"},
        "cgroup_cpu",
    ),
    (
        {
            "proc/self/cgroup": "4:cpu,cpuacct:/lxc/x",
            "sys/fs/cgroup/cpu/lxc/x/cpu.rt_runtime_us": "0",
        },
        "cgroup_cpu",
    ),
    (
        {
            "proc/self/cgroup": "4:cpu,cpuacct:/lxc/x",
            "sys/fs/cgroup/cpu/lxc/x/cpu.cfs_quota_us": "5000",
            "sys/fs/cgroup/cpu/lxc/x/cpu.cfs_period_us": "100000",
        },
        "cgroup_cpu",
    ),
    ({"proc/cpuinfo": "flags : fpu hypervisor sse2\n"}, "virtualised"),
    ({"proc/swaps": "Filename Type Size\n/dev/sda2 partition 100 0 -2"}, "swap"),
    ({"proc/42/timerslack_ns": "50000"}, "timer_slack"),
]


@dataclass
class Paced:
    grants: list = field(default_factory=list)
    thread_id: int = 42


def tree(root, files):
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_a_tuned_system_lacks_nothing(tmp_path):
    items = au.audit(Paced(), tree(tmp_path, TUNED))
    assert [item.name for item in items if not item.ok] == []
    assert len({item.name for item in items}) == len(items) == 11


@pytest.mark.parametrize(("spoil", "name"), SPOILED, ids=[name for _, name in SPOILED])
def test_each_lack_is_named_alone_and_mended(tmp_path, spoil, name):
    items = au.audit(Paced(), tree(tmp_path, TUNED | spoil))
    (lack,) = (item for item in items if not item.ok)
    assert lack.name == name
    assert lack.found
    assert lack.wanted
    assert lack.remedy


def test_capabilities_replace_limits(tmp_path):
    both = f"{1 << 14 | 1 << 23:016x}"
    limits = "Max realtime priority 0 0\nMax locked memory 65536 65536\n"
    files = {"proc/self/limits": limits, "proc/self/status": f"CapEff:\t{both}\n"}
    items = {
        item.name: item for item in au.audit(Paced(), tree(tmp_path, TUNED | files))
    }
    assert items["rtprio_limit"].found == "CAP_SYS_NICE"
    assert items["memlock_limit"].ok


def test_what_the_thread_knows_of_its_slack_replaces_the_file(tmp_path):
    granted = AuditFinding("timer_slack", ok=True, wanted="1 ns", found="1 ns")
    items = au.audit(
        Paced([granted]), tree(tmp_path, TUNED | {"proc/42/timerslack_ns": ""})
    )
    assert [item.found for item in items if item.name == "timer_slack"] == ["1 ns"]


def test_an_empty_tree_is_no_error(tmp_path):
    items = {item.name: item.ok for item in au.audit(Paced(), tmp_path)}
    assert not items["kernel"]
    assert not items["cpu_dma_latency"]
    assert not items["rtprio_limit"]
    assert items["swap"]


def test_grants_of_the_scheduler_are_part_of_it(tmp_path):
    refused = AuditFinding(
        "thread_priority", False, "not permitted", "SCHED_FIFO 80", "LimitRTPRIO=80"
    )
    items = au.audit(Paced([refused]), tree(tmp_path, TUNED))
    assert items[-1] == au.AuditFinding(
        "thread_priority", False, "not permitted", "SCHED_FIFO 80", "LimitRTPRIO=80"
    )
    (line,) = au.as_lines(items[-1:])
    assert line.startswith("missing thread_priority")
    assert line.endswith("not permitted (wanted: SCHED_FIFO 80; LimitRTPRIO=80)")
