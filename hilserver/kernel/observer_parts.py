"""The observer's part of its slice, called like `parts` by the generated step."""

from typing import Any, NamedTuple

from hilserver.compiled import inlined
from hilserver.compiled.records import record_at
from hilserver.image import word
from hilserver.image.layout import Layout
from hilserver.kernel.places import Places, p, q, x, y
from hilserver.observer.layout import SHOWN, Shown
from hilserver.observer.slice import begin_run, end_run, new_gyro, new_pose, when
from hilserver.plant.layout import N_WHEELS
from hilserver.signals import MEASURED, SignalTable
from hilserver.status import GOOD

N_SHOWN = Shown.n_words


class ObserverPlaces(NamedTuple):
    """Where the observer's numbers begin, and the slots that it reads."""

    # index into `values`: constants, and state
    c: int
    c_end: int
    f: int
    f_end: int
    # index into `values` and `words`: its outputs and their status codes
    out: int
    status: int
    # period of the slices of the simulated sensors
    nav_ticks: int
    imu_ticks: int
    # first slot of each group of measured values
    speed: int
    gyro: int
    nav: int
    # slots of the sample counters of imu and nav, and of the samples' times [s]
    samples: tuple[int, int]
    stamps: tuple[int, int]


def find_observer(
    layout: Layout, table: SignalTable, nav_ticks: int, imu_ticks: int
) -> ObserverPlaces:
    """Return the places of a layout that has an observer."""
    c, f = layout.regions["observer_p"], layout.regions["observer"]
    first = table.slot("estimate.x_m")
    return ObserverPlaces(
        c=c.base,
        c_end=c.base + c.length,
        f=f.base,
        f_end=f.base + f.length,
        out=layout.regions["frame"].base + first,
        status=layout.regions["status"].base + first,
        nav_ticks=nav_ticks,
        imu_ticks=imu_ticks,
        speed=table.slot(f"{MEASURED}wheel.fl.speed_rpm"),
        gyro=table.slot(f"{MEASURED}imu.gyro_z_rad_s"),
        nav=table.slot(f"{MEASURED}nav.x_m"),
        samples=(
            table.slot("internal.samples_imu"),
            table.slot("internal.samples_nav"),
        ),
        stamps=(table.slot("internal.time_imu_s"), table.slot("internal.time_nav_s")),
    )


@inlined
def _seconds(tick: int, words: Any) -> float:
    return float(tick * (words[word.BASE_PERIOD_NS] * 1e-9))


@inlined
def simulated(
    at: Places, ob: ObserverPlaces, tick: int, values: Any, words: Any
) -> None:
    """Observe the simulated robot through its simulated sensors."""
    c, f = values[ob.c : ob.c_end], values[ob.f : ob.f_end]
    plant, state, shown = p(at, values), x(at, values), y(at, values)
    angle = 0.5 * (shown.angle[0] + shown.angle[1])
    begin_run(c, f, _seconds(tick, words), shown.speed, angle)
    if q(at, words).gyro == GOOD:
        taken = _seconds(tick - tick % ob.imu_ticks, words)
        new_gyro(plant, c, f, state.imu_runs, taken, shown.gyro)
    if q(at, words).nav[0] == GOOD:
        taken = _seconds(tick - tick % ob.nav_ticks, words)
        nav = shown.nav
        new_pose(plant, c, f, state.nav_samples, taken, nav[0], nav[1], nav[2])
    codes = words[ob.status : ob.status + N_SHOWN]
    end_run(plant, c, f, True, record_at(values, ob.out, SHOWN), codes)


@inlined
def measured(
    at: Places, ob: ObserverPlaces, tick: int, values: Any, words: Any
) -> None:
    """Observe the real robot through its measured values."""
    c, f = values[ob.c : ob.c_end], values[ob.f : ob.f_end]
    plant, now = p(at, values), _seconds(tick, words)
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    speed = values[frame + ob.speed : frame + ob.speed + N_WHEELS]
    is_read = True
    for i in range(N_WHEELS):
        is_read &= words[status + ob.speed + i] == GOOD
    begin_run(c, f, now, speed, 0.0)
    if words[status + ob.gyro] == GOOD:
        came = when(values[frame + ob.stamps[0]], now)
        new_gyro(
            plant, c, f, values[frame + ob.samples[0]], came, values[frame + ob.gyro]
        )
    first = frame + ob.nav
    if (
        words[status + ob.nav]
        == words[status + ob.nav + 1]
        == words[status + ob.nav + 2]
        == GOOD
    ):
        count, came = (
            values[frame + ob.samples[1]],
            when(values[frame + ob.stamps[1]], now),
        )
        new_pose(
            plant,
            c,
            f,
            count,
            came,
            values[first],
            values[first + 1],
            values[first + 2],
        )
    codes = words[ob.status : ob.status + N_SHOWN]
    end_run(plant, c, f, is_read, record_at(values, ob.out, SHOWN), codes)
