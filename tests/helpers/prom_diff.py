"""Assert on what a stimulus changes in the metrics, never on absolute values.

with PromDiff(metrics.registry) as diff:
    stimulus()
assert diff["hil_overruns_total", {"slice": "plant", "cause": "long_run"}] == 1
"""

from collections.abc import Callable, Mapping
from types import TracebackType

from prometheus_client import CollectorRegistry
from prometheus_client.parser import text_string_to_metric_families

Series = tuple[str, frozenset[tuple[str, str]]]


def series_of_text(text: str) -> dict[Series, float]:
    """Return every series of an exposition in text format."""
    return {
        (sample.name, frozenset(sample.labels.items())): float(sample.value)
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def series_of_registry(registry: CollectorRegistry) -> dict[Series, float]:
    """Return every series of a registry in this process."""
    return {
        (sample.name, frozenset(sample.labels.items())): float(sample.value)
        for family in registry.collect()
        for sample in family.samples
    }


class PromDiff:
    """Difference of all series between entry and exit of a ``with`` block.

    `source` is a registry, or a callable that returns an exposition (a scrape over HTTP).
    """

    def __init__(self, source: CollectorRegistry | Callable[[], str]) -> None:
        self._source = source

    def _read(self) -> dict[Series, float]:
        if isinstance(self._source, CollectorRegistry):
            return series_of_registry(self._source)
        return series_of_text(self._source())

    def __enter__(self) -> "PromDiff":
        self.before = self._read()
        self.after: dict[Series, float] = {}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.after = self._read()

    def __getitem__(self, key: str | tuple[str, Mapping[str, str]]) -> float:
        """Return after minus before; a series that did not exist before counts from 0."""
        name, labels = (key, {}) if isinstance(key, str) else key
        series = (name, frozenset(labels.items()))
        if series not in self.after:
            known = sorted(str(dict(s[1])) for s in self.after if s[0] == name)
            raise KeyError(
                f"no series {name}{dict(labels)}; of this name there are {known}"
            )
        return self.after[series] - self.before.get(series, 0.0)

    def moved(self) -> set[str]:
        """Return the names of all series that changed, appeared or went."""
        every = self.before.keys() | self.after.keys()
        return {s[0] for s in every if self.before.get(s) != self.after.get(s)}
