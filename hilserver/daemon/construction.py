"""The arena and the scheduler of an assembly: from configured times and limits to ticks."""

import os
import time

from hilserver.config.timing import LimitsConfig
from hilserver.daemon.assembly import Assembly
from hilserver.image import ProcessImage
from hilserver.image.shared_file import MADE_UP
from hilserver.scheduler import (
    OverrunLimits,
    OverrunPolicy,
    RealtimeSettings,
    Scheduler,
    StepFunction,
    words_needed,
)

LINEAR_BINS = 10_000


def make_image(assembly: Assembly) -> ProcessImage:
    """Return the process image with a region for everything that the assembly runs."""
    image, composition = assembly.config.image, assembly.composition
    is_auto = image.name == MADE_UP
    return ProcessImage(
        f"{MADE_UP}-{os.getpid()}-{time.monotonic_ns()}" if is_auto else image.name,
        assembly.table,
        live=composition.live_regions,
        fixed=composition.fixed_regions
        | {"statistics": words_needed(len(assembly.slices), LINEAR_BINS)},
        base_period_ns=assembly.base_period_ns,
        ring_length=image.ring_frames,
        run=assembly.provenance,
    )


def overrun_limits(limits: LimitsConfig) -> OverrunLimits:
    """Return the limits as the scheduler takes them: null switches one off."""
    return OverrunLimits(
        single_ns=round((limits.single_overrun_ms or 0) * 1e6),
        consecutive=limits.consecutive_overruns or 0,
    )


def command_limit_ticks(assembly: Assembly) -> int:
    """Return the command time-out in ticks, 0 without one."""
    limit_ms = assembly.config.control.command_timeout_ms
    return 0 if limit_ms is None else max(1, round(limit_ms * 1e6 / assembly.base_period_ns))


def make_scheduler(
    assembly: Assembly, image: ProcessImage, step: StepFunction, *, paused: bool
) -> Scheduler:
    """Return the scheduler that drives `step` over the memory of `image`."""
    config = assembly.config.scheduler
    realtime = config.realtime
    _, statistics = image.region("statistics")
    return Scheduler(
        base_period_ns=assembly.base_period_ns,
        slices=assembly.slices,
        step=step,
        values=image.values,
        words=image.words,
        backend=config.backend,
        policy=OverrunPolicy(config.policy, config.catch_up_limit),
        limits=overrun_limits(config.limits),
        realtime=RealtimeSettings(
            priority=realtime.priority,
            cpu=realtime.cpu,
            lock_memory=realtime.lock_memory,
            hold_latency_target=realtime.hold_latency_target,
        ),
        statistics_array=statistics,
        linear_bins=LINEAR_BINS,
        paused=paused,
    )
