"""Definition of a scenario, and of what must be found in its logs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from hilserver_injector import Recipe


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """What must be found."""

    # for each, a finding must hold one of these causes
    must_say: tuple[frozenset[str], ...] = ()
    # causes that one group must hold, because the log cannot tell them apart
    together: frozenset[str] = frozenset()
    must_not_say: frozenset[str] = frozenset()  # causes that no finding may hold
    # the verdict on the whole: findings, nothing_found, not_judged, differs, no_difference
    verdict: str | None = None
    or_structure: bool = False  # True: ``structure_not_in_library`` is right too


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioDrive:
    """One random realisation of a scenario."""

    # logs by file name; with `against`, the question is whether those differ from `logs`
    logs: Mapping[str, Recipe]
    expectation: Expectation
    hidden: str  # what was hidden, in words
    against: Mapping[str, Recipe] = field(default_factory=dict)
    config: str = "{}\n"  # the configuration to judge it with, YAML


@dataclass(frozen=True, slots=True)
class ThesisScenario:
    """A named drive of the thesis."""

    name: str
    says: str
    draw: Callable[[int], ScenarioDrive]
