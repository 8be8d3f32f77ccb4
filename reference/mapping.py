"""The page of mapping files."""

from hilserver.measured.builtin import builtin_mappings
from hilserver.measured.mapping import ChannelMap, ColumnMap, ReferenceMap, TimeMap
from hilserver.measured.names import ONLY_MAPPED_UNITS, known_signals, units_of
from reference.configuration import rows_of

HEAD = """# Mapping files: foreign logs

Made from the code by `make reference`; a test keeps it up to date.
A mapping says which column of a table, or which topic and field of a ROS 2 bag, is which signal:
`hilserver diagnose LOG --mapping map.yaml`. Columns that it does not name are ignored. How to
write one: [Read foreign logs](../how-to/read-foreign-logs.md).

Built in, to be named instead of a file: {builtin}.

| key | type | default | meaning |
|---|---|---|---|
"""

PLANT = """| `plant.<key>` | as in the configuration | none | the measured machine: the keys of \
[`plant`](configuration.md); a `track_m` without `wheelbase_m` means two wheels, K_om = 1/track |
"""

TAIL = """
Unit, sign, scale and offset are applied in this order. A unit has to measure what the signal
measures; `unit: "1"` with a `scale` turns bare counts into the signal's unit. Wheels have the
plant's signs: driving forward is positive on the left and negative on the right, so a right wheel
that counts forward as positive has `sign: -1`.

Besides signals a mapping may name {others}: signals are made of them, see
[references](../how-to/references.md).

| signal | its unit | units that fit |
|---|---|---|
"""


def as_markdown() -> str:
    """Return the reference as Markdown."""
    builtin = ", ".join(f"`{name}`" for name in builtin_mappings())
    keys = [
        rows_of(TimeMap, "time."),
        rows_of(ColumnMap, "segment."),
        rows_of(ColumnMap, "block."),
        PLANT,
        rows_of(ReferenceMap, "reference."),
        rows_of(ChannelMap, "channels.<signal>."),
    ]
    others = ", ".join(f"`{n}` [{unit}]" for n, unit in ONLY_MAPPED_UNITS.items())
    signals = "".join(
        f"| `{name}` | {signal.unit} | {', '.join(units_of(signal.unit))} |\n"
        for name, signal in known_signals().items()
    )
    return (
        HEAD.format(builtin=builtin)
        + "".join(keys)
        + TAIL.format(others=others)
        + signals
    )
