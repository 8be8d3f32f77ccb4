"""The result of a sweep as a table: what each machine was, and what became of it."""

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError, LogError
from hilserver.program.whole_file import whole, write_whole
from hilserver.sweep.journal import SweepJournal
from hilserver.sweep.prepare import PreparedSweep

PASSED, FAILED, ERROR, REFUSED = STATUSES = ("passed", "failed", "error", "refused")
SUMMARY: Final = "summary.json"
MARGIN, FAULT = "margin: ", "fault: "
_TEXTS = ("status", "message", "computer")


@dataclass(frozen=True)
class MachineTable:
    """One row per machine."""

    # shape (n,)
    index: NDArray[np.int64]
    seed: NDArray[np.int64]
    parameters: Mapping[str, NDArray[np.float64]]  # drawn values, by full name
    faults: Mapping[str, NDArray[np.float64]]  # 1 where a machine has it
    # by requirement; NaN if a machine could not be driven
    margins: Mapping[str, NDArray[np.float64]]
    # one of `STATUSES`; the reason; the computer, if its bits may differ
    status: list[str]
    message: list[str]
    computer: list[str]
    # words about the sweep, see `summary`
    about: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.index)

    def count(self, status: str) -> int:
        """Return how many machines have a status."""
        return self.status.count(status)

    @property
    def worst_margin(self) -> NDArray[np.float64]:
        """Smallest margin of each machine in units of its requirement's spread, shape (n,).

        Requirements have different units: each margin is divided by the median size of its
        requirement's margins. NaN if the machine could not be driven.
        """
        worst = np.full(len(self), np.inf)
        for values in self.margins.values():
            sizes = np.abs(values[np.isfinite(values)])
            scale = float(np.median(sizes)) if len(sizes) else 1.0
            worst = np.fmin(worst, values / (scale or 1.0))
        worst[np.isinf(worst) & (worst > 0.0)] = np.nan
        return worst

    def columns(self) -> dict[str, Any]:
        """Return the columns of the file by name."""
        faults_drawn = {FAULT + name: values for name, values in self.faults.items()}
        margins_drawn = {MARGIN + name: values for name, values in self.margins.items()}
        return {
            "index": self.index,
            "seed": self.seed,
            "status": self.status,
            **self.parameters,
            **faults_drawn,
            **margins_drawn,
            "message": self.message,
            "computer": self.computer,
        }


def table_of(
    prepared: PreparedSweep, journal: SweepJournal, indices: range
) -> MachineTable:
    """Return the finished machines, in the order of the indices."""
    found = [index for index in indices if index in journal.done]
    draws = prepared.draws
    names = prepared.draws.names
    values = np.empty((len(names), len(found)))
    faults = np.zeros((len(draws.faults), len(found)))
    margins = np.full((len(prepared.sweep.require), len(found)), np.nan)
    status = []
    message = []
    for row, index in enumerate(found):
        drawn = draws.values(index)
        outcome = journal.done[index]
        values[:, row] = [drawn[name] for name in names]
        for number, _ in draws.faults_of(index):
            faults[number, row] = 1.0
        if outcome.margins:
            margins[:, row] = outcome.margins
        driven = PASSED if outcome.passed else FAILED
        status.append(
            REFUSED if outcome.refused else ERROR if outcome.error else driven
        )
        message.append(outcome.refused or outcome.error)
    titles = [item.fault.title for item in draws.faults]
    titles = [t if t not in titles[:k] else f"{t} ({k})" for k, t in enumerate(titles)]
    return MachineTable(
        np.array(found, dtype=np.int64),
        np.array([draws.plant_seed(index) for index in found], dtype=np.int64),
        dict(zip(names, values, strict=True)),
        dict(zip(titles, faults, strict=True)),
        dict(zip((r.name for r in prepared.sweep.require), margins, strict=True)),
        status,
        message,
        [journal.where.get(index, "") for index in found],
        summary(prepared),
    )


def summary(prepared: PreparedSweep) -> dict[str, Any]:
    """Return what a report states about the sweep, in addition to the table."""
    sweep = prepared.sweep
    return {
        "schema": "hilserver.sweep_summary/1",
        "sweep": prepared.job.path.name,
        "key": prepared.job.key,
        "machines": sweep.machines,
        "seed": sweep.seed,
        "duration_s": prepared.job.n_ticks * prepared.assembly.base_period_ns * 1e-9,
        "of_one_machine": []
        if prepared.draws.joint is None
        else list(prepared.draws.joint.names),
        "population": list(prepared.draws.population),
        "left_out": list(prepared.left_out),
        "units": {name: prepared.table[name].unit for name in prepared.draws.names},
        "shares": {r.name: r.share for r in sweep.require},
        "requirement_units": {r.name: _unit(prepared, r.signal) for r in sweep.require},
    }


def _unit(prepared: PreparedSweep, signal: str | None) -> str:
    if signal is None:
        return ""
    signals = prepared.assembly.table
    return signals[signal].unit if signal in signals else "m"  # the distance to the way


def write_table(folder: Path, table: MachineTable) -> Path:
    """Write the table, as Parquet where pyarrow is installed, else as CSV; return the file."""
    text = json.dumps(table.about, indent=1) + "\n"
    write_whole(folder / SUMMARY, text.encode())
    if find_spec("pyarrow") is None:
        return _write_csv(folder / "results.csv", table)
    import pyarrow as pa  # noqa: PLC0415 -- an extra
    from pyarrow import parquet  # noqa: PLC0415 -- an extra

    path = folder / "results.parquet"
    with whole(path) as partial:
        parquet.write_table(pa.table(table.columns()), partial)
    return path


def _write_csv(path: Path, table: MachineTable) -> Path:
    columns = table.columns()
    with (
        whole(path) as partial,
        partial.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(columns)
        plain = [c if isinstance(c, list) else c.tolist() for c in columns.values()]
        writer.writerows(zip(*plain, strict=True))
    return path


def read_table(folder: Path) -> MachineTable:
    """Return the result of a sweep from its folder.

    LogError if there is none, or it cannot be read.
    """
    try:
        about = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        columns = _read_columns(folder)
    except (OSError, ValueError, KeyError) as error:
        raise LogError(
            f"{folder}: contains no finished sweep: {error!s:.120}"
        ) from None
    numbers = {
        k: np.array(v, dtype=np.float64) for k, v in columns.items() if k not in _TEXTS
    }
    names = (*about["of_one_machine"], *about["population"])
    return MachineTable(
        np.array(columns["index"], dtype=np.int64),
        np.array(columns["seed"], dtype=np.int64),
        {name: numbers[name] for name in names},
        {k.removeprefix(FAULT): v for k, v in numbers.items() if k.startswith(FAULT)},
        {k.removeprefix(MARGIN): v for k, v in numbers.items() if k.startswith(MARGIN)},
        columns["status"],
        columns["message"],
        columns["computer"],
        about,
    )


def _read_columns(folder: Path) -> dict[str, list[Any]]:
    path = folder / "results.parquet"
    if path.exists():
        try:
            from pyarrow import parquet  # noqa: PLC0415 -- an extra
        except ImportError:
            raise FailedError(
                f"{path}: needs pyarrow: pip install 'hilserver[parquet]'"
            ) from None
        columns: dict[str, list[Any]] = parquet.read_table(path).to_pydict()
        return columns
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    return {
        name: list(column)
        for name, column in zip(rows[0], zip(*rows[1:], strict=True), strict=True)
    }
