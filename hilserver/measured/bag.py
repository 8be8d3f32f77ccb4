"""ROS 2 bags through a mapping: topic and field to signal."""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.errors import LogError, meant
from hilserver.logs.bag_messages import Bag, Topic, is_bag, read_messages
from hilserver.logs.table import first_of_equal, repeated_stamps
from hilserver.measured.mapping import LogMapping
from hilserver.measured.messages import Decoder, TopicError
from hilserver.measured.tables import Recording, Stamped, as_signal
from hilserver.measured.thresholds import SET_BACK_MESSAGES

__all__ = ["is_bag", "read_bag"]


def read_bag(path: Path, mapping: LogMapping) -> Recording:
    """Read the topics that a mapping names; LogError names file, topic, field and remedy."""
    wanted = {str(channel.topic) for channel in mapping.channels.values()}
    bags = read_messages(path, wanted)
    topics: dict[str, Topic] = {}
    notices: list[str] = []
    for bag in bags:
        topics |= bag.topics
        notices += bag.notices

    for name, channel in mapping.channels.items():
        if channel.topic not in topics and not channel.optional:
            known = f"the topics are {', '.join(sorted(topics)):.200}"
            hint = meant(str(channel.topic), topics, known)
            raise LogError(
                f"{path}: there is no topic '{channel.topic}', which the mapping names for {name};"
                f" {hint}"
            )

    parts = []
    failed = []
    for name in sorted(wanted & set(topics)):
        if not any(bag.messages.get(name) for bag in bags):
            mapped = mapping.channels.items()
            signals = [s for s, channel in mapped if channel.topic == name]
            notices.append(
                f"{path}: topic '{name}' contains no messages; there are no data for"
                f" {', '.join(signals)}"
            )
            continue
        try:
            parts.append(_part(path, name, topics[name], bags, mapping, notices))
        except TopicError as error:
            failed.append(error)
    if not parts and failed:
        raise failed[0]
    if not parts:
        raise LogError(f"{path}: the mapped topics contain no messages; record them")
    notices += map(str, failed)
    start_ns = min(int(stamps_ns[0]) for stamps_ns, _ in parts)
    stamped = []
    for stamps_ns, columns in parts:
        t_s = np.multiply(stamps_ns - start_ns, 1e-9, dtype=np.float64)
        segment = np.zeros(len(stamps_ns), dtype=np.int64)
        stamped.append(Stamped(t_s, segment, columns))
    return Recording(path, stamped, notices=notices)


def _part(
    path: Path,
    name: str,
    topic: Topic,
    bags: Sequence[Bag],
    mapping: LogMapping,
    notices: list[str],
) -> tuple[Indices, dict[str, Array]]:
    """Return stamps [ns] and channels of one topic, sorted; of equal ones the first counts."""
    where = f"{path}: topic '{name}'"
    decoder = Decoder(where, topic)
    mapped = mapping.channels.items()
    fields = {signal: str(c.field) for signal, c in mapped if c.topic == name}
    is_from_header = mapping.time.stamp == "header"
    of_file = [bag.messages.get(name, []) for bag in bags]
    messages = list(chain.from_iterable(of_file))
    rows, stamps, values = decoder.numbers(
        messages, list(fields.values()), from_header=is_from_header
    )

    def place(row: int, at: str) -> str:
        """Return the place of a number in complaints."""
        return f"{where}: message {row + 1}, {at}"

    converted = []
    for (signal, at), column in zip(fields.items(), values.T, strict=True):
        converted.append(as_signal(mapping, signal, column, at, place))

    values = np.stack(converted, axis=1)

    # Files of one bag may stand in any order, and other frames on a topic have other clocks.
    sampled = np.isfinite(values).any(axis=1)
    begin = 0
    for bag, own in zip(bags, of_file, strict=True):
        used = sampled & (rows >= begin) & (rows < begin + len(own))
        _refuse_set_back(
            f"{bag.path}: topic '{name}'", rows[used] - begin, stamps[used]
        )
        begin += len(own)

    order = np.argsort(stamps, kind="stable")
    stamps = stamps[order]
    values = values[order]
    segment = np.zeros(len(stamps), dtype=np.int64)
    values, first, repeated = first_of_equal(stamps, segment, values)
    notices += decoder.notices
    notices += repeated_stamps(where, repeated, "messages")
    return stamps[first], dict(zip(fields, values.T, strict=True))


def _refuse_set_back(where: str, rows: Indices, stamps_ns: Indices) -> None:
    """Refuse a file if the clock of its stamps was set back meanwhile.

    Sorted, the messages after that would stand between those before it.
    """
    latest_ns = np.maximum.accumulate(stamps_ns)
    in_time = np.append(np.flatnonzero(stamps_ns >= latest_ns), len(stamps_ns))
    late = np.diff(in_time) - 1
    if late.max(initial=0) < SET_BACK_MESSAGES:
        return

    last = int(in_time[np.argmax(late)])
    by_s = (stamps_ns[last] - stamps_ns[last + 1]) * 1e-9
    raise LogError(
        f"{where}: the clock was set back by {by_s:.3g} s after message {rows[last] + 1}; cut the"
        " bag there and give one part"
    )
