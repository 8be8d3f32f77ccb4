"""MF4 of ASAM (MDF 4.1), if the library for it is installed.

One group holds the whole log: a channel for every signal with its unit, `t_s`, `segment` and
`block`, and ``<signal>.status`` if a status code is not Good. The time of the group rises over
all segments; in a log of one segment it is `t_s`. The description of the run, which accompanies a
CSV log in a separate file, is an attachment here.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError
from hilserver.logs.log import NS_PER_S, Log, RecordedState
from hilserver.logs.provenance import check_run, pack_meta, unpack_meta
from hilserver.logs.rewriting import as_table, run_of, stamps
from hilserver.logs.table import BLOCK, SEGMENT, TIME
from hilserver.logs.unpacking import Budget

if TYPE_CHECKING:
    from asammdf import MDF
    from asammdf.blocks.mdf_v4 import MDF4

META: Final = "hilserver.meta.json"
STATUS: Final = ".status"
UNKNOWN: Final = datetime.fromtimestamp(0, UTC)  # a log has no date of recording


def write_mf4(log: Log, path: Path, unit_of: Callable[[str], str]) -> None:
    """Write a log as MF4; LogError if asammdf is not installed."""
    library = _library(path)
    from asammdf import Signal  # noqa: PLC0415 -- an extra

    described = [] if log.run is None else log.run["signals"]
    units = {TIME: "s"} | {signal["name"]: signal["unit"] for signal in described}
    offset_ns = stamps(log) - np.rint(log.t_s * NS_PER_S).astype(np.int64)
    master = log.t_s + offset_ns / NS_PER_S
    channels = [
        Signal(
            np.ascontiguousarray(values),
            master,
            name=name,
            unit=units.get(name) or unit_of(name),
        )
        for name, values in _columns(log)
    ]
    with library(version="4.10") as mdf:
        mdf.start_time = UNKNOWN
        mdf.append(channels, acq_name="hilserver", comment="", common_timebase=True)
        if log.run is not None:
            text = pack_meta(run_of(log), log.states)
            mdf.attach(text.encode(), META, mime="application/json")
        mdf.save(path)  # not compressed: some readers do not support compressed blocks


def _columns(log: Log) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, values in as_table(log).items():
        yield name, values
        codes = log.status.get(name)
        if codes is not None and codes.any():
            yield name + STATUS, codes.astype(np.uint32)


def read_mf4(path: Path) -> Log:
    """Read an MF4 file that `write_mf4` wrote; see `reading.read_log`.

    LogError if asammdf is not installed, the file is damaged, or another program wrote it.
    """
    library = _library(path)
    path.open("rb").close()  # the system's own message if it cannot be opened
    try:
        with library(path) as mdf:
            run, states = _meta(mdf)
            if not {TIME, SEGMENT} <= set(mdf.channels_db):
                raise LogError(
                    f"{path}: was not written by hilserver (no channel '{TIME}'); export it as CSV"
                    " or Parquet, and give a mapping of its columns"
                )
            group, _ = mdf.channels_db[TIME][0]
            names = [channel.name for channel in mdf.groups[group].channels]
            n_rows = mdf.groups[group].channel_group.cycles_nr
            Budget(path).take(n_rows * len(names) * 8)
            wanted = [(name, group, place) for place, name in enumerate(names)][1:]
            table = {
                signal.name: signal.samples for signal in mdf.select(wanted, raw=True)
            }
    except LogError:
        raise
    except Exception as error:  # noqa: BLE001 -- damaged bytes fail the library in many ways
        raise LogError(
            f"{path}: not a readable MF4 file: {str(error) or type(error).__name__:.120}"
        ) from None
    return _as_log(path, table, run, states)


def _meta(mdf: "MDF") -> tuple[dict[str, Any] | None, list[RecordedState]]:
    for index, attachment in enumerate(mdf.attachments):
        if attachment.file_name == META:
            return unpack_meta(mdf.extract_attachment(index)[0].decode())
    return None, []


def _as_log(
    path: Path,
    table: dict[str, NDArray[Any]],
    run: dict[str, Any] | None,
    states: list[RecordedState],
) -> Log:
    t_s = table.pop(TIME)
    segment = table.pop(SEGMENT)
    block = table.pop(BLOCK, None)
    names = [
        name for name in table if name.removesuffix(STATUS) not in table.keys() - {name}
    ]
    if run is not None:
        try:
            check_run(run, names)
        except ValueError as error:
            raise LogError(
                f"{path}: its record of the run {error}; record it again"
            ) from None
    good = np.zeros(len(t_s), dtype=np.int64)
    status = {name: table.get(name + STATUS, good).astype(np.int64) for name in names}
    return Log(
        path,
        t_s,
        segment,
        {name: table[name] for name in names},
        block,
        status={} if run is None else status,
        run=run,
        states=states,
    )


def _library(path: Path) -> Any:
    try:
        from asammdf import MDF  # noqa: PLC0415 -- an extra
        from asammdf.blocks.mdf_v4 import MDF4  # noqa: PLC0415
    except ImportError:
        raise LogError(
            f"{path}: MF4 needs the library asammdf; install it with"
            " \"pip install 'hilserver[mdf]'\", or use CSV or MCAP"
        ) from None
    # It logs what it cannot read and leaves half an object whose destructor prints a traceback; its
    # exception is enough for us.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)
    MDF4.__del__ = _end
    return MDF


def _end(half: "MDF4") -> None:
    with suppress(AttributeError):
        half.close()
