"""A comparison in words: one sentence, then what parted when, then what is not the same."""

from collections.abc import Iterator, Sequence
from typing import Final

from hilserver.comparison.comparing import HORIZONS_S, Parting, RecordingComparison
from hilserver.measured.names import known_signals

_MOST: Final = 12
"""Signals, keys and names that are listed; of the rest the number is said."""


def as_text(found: RecordingComparison) -> str:
    """Return lines for a terminal."""
    lines = []
    if found.partings:
        first = found.partings[0]
        where = f" of segment {first.segment}" if first.segment else ""
        lines += [
            f"They differ from {first.t_s:.9g} s{where} on;"
            f" {found.equal_before} rows before that are equal.",
            f"First: {_first(found)}",
            "",
            *_table(found.partings),
        ]
    else:
        lines.append(f"Equal: {found.rows} rows of {found.signals} signals.")

    for name, rows, signals in zip("AB", found.alone, found.only_in, strict=True):
        if rows:
            lines.append(f"{rows} rows are only in {name}.")
        if signals:
            lines.append(f"Only in {name}: {_listed(signals, ', ')}.")

    if found.changes:
        changes = [f"  {c.key}: {c.a} in A, {c.b} in B" for c in found.changes]
        lines += ["", "Not the same in their runs:", _listed(changes, "\n")]
    return "\n".join(lines)


def _listed(texts: Sequence[str], between: str) -> str:
    """Join the first ones; say how many there are beyond them."""
    if len(texts) > _MOST:
        more = [f"  and {len(texts) - _MOST} more"]
    else:
        more = []
    return between.join([*texts[:_MOST], *more])


def _first(found: RecordingComparison) -> str:
    """Say which signal parted first, and whether it came from outside."""
    first = found.partings[0]
    together = [
        p for p in found.partings if (p.segment, p.t_ns) == (first.segment, first.t_ns)
    ]
    inputs = [p for p in together if p.signal in found.inputs]
    one = (inputs or together)[0]
    unit = known_signals()[one.signal].unit if one.signal in known_signals() else ""
    values = f"{one.signal} is {_apart(one.a, one.b)}"
    unit = f" [{unit}]" if unit not in ("", "1") else ""
    others = f", with {len(together) - 1} others" if len(together) > 1 else ""
    if inputs:
        return f"{values}{unit}{others}: what came in was not the same."
    if found.inputs:
        return f"{values}{unit}{others}: an output, while all inputs that both have were equal."
    return f"{values}{unit}{others}."


def _apart(a: float, b: float) -> str:
    """Write two values with as many digits as tell them apart; 17 always do."""
    digits = 9 if f"{a:.9g}" != f"{b:.9g}" else 17
    return f"{a:.{digits}g} in A, {b:.{digits}g} in B"


def _table(partings: list[Parting]) -> Iterator[str]:
    horizons = [f"{h:g} s" if h else "at once" for h in HORIZONS_S] + ["ever"]
    width = max(
        len("largest difference by"), *(len(p.signal) for p in partings[:_MOST])
    )
    head = "".join(f"{name:>11}" for name in horizons)
    yield f"{'largest difference by':{width}}  {'parts at':>12}{head}"
    for parting in partings[:_MOST]:
        sizes = "".join(f"{size:>11.3g}" for size in parting.largest)
        yield f"{parting.signal:{width}}  {parting.t_s:>10.6g} s{sizes}"
    if len(partings) > _MOST:
        yield f"and {len(partings) - _MOST} more signals"
