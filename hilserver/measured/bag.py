"""ROS 2 bags through a mapping: topic and field to signal."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.errors import LogError, meant
from hilserver.logs.bag_messages import Topic, is_bag, read_messages
from hilserver.logs.table import first_of_equal, repeated_stamps
from hilserver.measured.mapping import LogMapping
from hilserver.measured.messages import Decoder, TopicError
from hilserver.measured.tables import Recording, Stamped, as_signal

__all__ = ["is_bag", "read_bag"]


def read_bag(path: Path, mapping: LogMapping) -> Recording:
    """Read the topics that a mapping names; LogError names file, topic, field and remedy."""
    wanted = {str(channel.topic) for channel in mapping.channels.values()}
    bags = read_messages(path, wanted)
    topics = {name: topic for bag in bags for name, topic in bag.topics.items()}
    messages = {
        name: [message for bag in bags for message in bag.messages.get(name, ())]
        for name in wanted & set(topics)
    }
    _refuse_absent(path, mapping, topics)
    notices = [notice for bag in bags for notice in bag.notices]
    parts, failed = [], []
    for name, sent in sorted(messages.items()):
        try:
            if sent:
                parts.append(_part(path, name, topics[name], sent, mapping, notices))
            else:
                notices.append(_empty(path, name, mapping))
        except TopicError as error:
            failed.append(error)
    if not parts and failed:
        raise failed[0]
    if not parts:
        raise LogError(f"{path}: the mapped topics contain no messages; record them")
    notices += map(str, failed)
    start_ns = min(int(stamps_ns[0]) for stamps_ns, _ in parts)
    stamped = [
        Stamped(
            np.multiply(stamps_ns - start_ns, 1e-9, dtype=np.float64),
            np.zeros(len(stamps_ns), dtype=np.int64),
            columns,
        )
        for stamps_ns, columns in parts
    ]
    return Recording(path, stamped, notices=notices)


def _refuse_absent(path: Path, mapping: LogMapping, topics: Collection[str]) -> None:
    for name, channel in mapping.channels.items():
        if channel.topic not in topics and not channel.optional:
            known = f"the topics are {', '.join(sorted(topics)):.200}"
            raise LogError(
                f"{path}: there is no topic '{channel.topic}', which the mapping names for {name};"
                f" {meant(str(channel.topic), topics, known)}"
            )


def _part(
    path: Path,
    name: str,
    topic: Topic,
    messages: list[tuple[int, bytes]],
    mapping: LogMapping,
    notices: list[str],
) -> tuple[Indices, dict[str, Array]]:
    """Return stamps [ns] and channels of one topic, sorted; of equal ones the first counts."""
    where = f"{path}: topic '{name}'"
    decoder = Decoder(where, topic)
    channels = {s: str(c.field) for s, c in mapping.channels.items() if c.topic == name}
    stamps, values = decoder.numbers(
        messages, list(channels.values()), from_header=mapping.time.stamp == "header"
    )
    converted = [
        as_signal(
            mapping,
            signal,
            column,
            at,
            lambda row, at: f"{where}: message {row + 1}, {at}",
        )
        for (signal, at), column in zip(channels.items(), values.T, strict=True)
    ]
    order = np.argsort(stamps, kind="stable")
    values, first, repeated = first_of_equal(
        stamps[order],
        np.zeros(len(order), dtype=np.int64),
        np.stack(converted, axis=1)[order],
    )
    notices += [*decoder.notices, *repeated_stamps(where, repeated, "messages")]
    return stamps[order][first], dict(zip(channels, values.T, strict=True))


def _empty(path: Path, name: str, mapping: LogMapping) -> str:
    signals = ", ".join(
        s for s, channel in mapping.channels.items() if channel.topic == name
    )
    return (
        f"{path}: topic '{name}' contains no messages; there are no data for {signals}"
    )
