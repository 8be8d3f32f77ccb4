"""`model_patch.yaml`: terms that a diagnosis has found, and where they were fitted.

Schema 2 adds parameters of any kind, tuned and saved by a user. A patch is a set of parameters,
laid over the configuration for one run. It is never written into config.yaml: a run without it
gives the old outputs, bit for bit.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from hilserver.config.loading import LIVE_BYTES, load, place
from hilserver.config.plant import PlantConfig
from hilserver.config.section import Section
from hilserver.errors import ConfigError
from hilserver.parameters import PLANT, check, named
from hilserver.parameters.table import BLOCK, TERM
from hilserver.plant.errors import PlantError
from hilserver.plant.terms import TERMS, complete, main_part

SCHEMA: Final = "hilserver.model_patch/1"
SCHEMA_2: Final = "hilserver.model_patch/2"
Interval = tuple[float, float]


class MadeFrom(Section):
    """Where a patch comes from."""

    findings_sha256: str = Field(
        "", description="hash of the findings.json next to it, if any"
    )
    config_sha256: str = Field(
        description="hash of the configuration that was diagnosed"
    )
    version: str = Field(description="version of hilserver that made it")


class FittedIn(Section):
    """What the machine did in the data; null: not excited, then nothing is said about it."""

    speed_m_s: Interval | None = Field(
        None, description="lowest and highest speed, with sign"
    )
    wheel_speed_rpm: Interval | None = Field(
        None, description="of all wheels, with sign"
    )
    turn_rate_rad_s: Interval | None = Field(
        None, description="smallest and largest, with sign"
    )
    voltage_v: Interval | None = Field(None, description="of the battery")
    conditions: str = Field("", description="logs, duration and rate, in words")

    @field_validator("speed_m_s", "wheel_speed_rpm", "turn_rate_rad_s", "voltage_v")
    @classmethod
    def _rises(cls, value: Interval | None) -> Interval | None:
        if value is not None and value[0] > value[1]:
            raise ValueError(
                f"{value[0]:g} .. {value[1]:g} falls; swap the two numbers"
            )
        return value


class PatchTerm(Section):
    """One term."""

    value: float = Field(description="value of the term, in its unit")
    unit: str = Field(description="symbol of the unit, as in the table of terms")
    ci95: Interval | None = Field(None, description="interval of 95 %")
    fitted_in: FittedIn = Field(
        default_factory=FittedIn, description="where it was fitted"
    )


class PatchParameter(Section):
    """One parameter of schema 2."""

    value: float | None = Field(
        description="value of the parameter, in its unit; may be null"
    )
    unit: str = Field(description="symbol of the unit, as in the table of parameters")


class ModelPatch(Section):
    """The file."""

    schema_: Literal["hilserver.model_patch/1", "hilserver.model_patch/2"] = Field(
        alias="schema", description="this format"
    )
    made_from: MadeFrom
    terms: dict[str, PatchTerm] = Field(
        {}, description="terms by name, as in plant.terms"
    )
    parameters: dict[str, PatchParameter] = Field(
        {},
        description="schema 2: parameters by name, as in docs/reference/parameters.md",
    )
    groups: dict[str, dict[str, PatchTerm]] | None = Field(
        None,
        description="more terms by group of logs (floor, load); a run takes one group",
    )

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="after")
    def _known_terms(self) -> Self:
        for group in self.groups or (None,):
            terms = self.terms_of(group)
            try:
                complete({name: term.value for name, term in terms.items()})
            except PlantError as error:
                raise ValueError(
                    self._placed(str(error).removeprefix("plant."), group)
                ) from None
            for name, term in terms.items():
                unit = TERMS[main_part(name)].unit
                if term.unit != unit:
                    text = f"terms.{name}.unit: the term has the unit {unit!r}"
                    raise ValueError(self._placed(text, group))
        return self

    @model_validator(mode="after")
    def _known_parameters(self) -> Self:
        if self.schema_ == SCHEMA and self.parameters:
            raise ValueError(f"parameters: need schema: {SCHEMA_2}")
        if self.schema_ == SCHEMA_2 and (self.terms or self.groups):
            raise ValueError(
                f"schema: {SCHEMA_2} has parameters in place of terms and groups"
            )
        if self.schema_ == SCHEMA and "terms" not in self.model_fields_set:
            raise ValueError("terms: is missing")
        for name, given in self.parameters.items():
            if name.startswith(BLOCK):
                continue
            try:
                parameter = PLANT[named(name, PLANT)]
                check(parameter, given.value)
            except PlantError as error:
                text = str(error).removeprefix(f"{name}: ")
                raise ValueError(f"parameters.{name}: {text}") from None
            if given.unit != parameter.unit:
                text = f"the parameter has the unit {parameter.unit!r}"
                raise ValueError(f"parameters.{name}.unit: {text}")
        return self

    def _placed(self, text: str, group: str | None) -> str:
        """Return a complaint about a term with its key in the file."""
        if group is None or any(
            text.startswith(f"terms.{name}") for name in self.terms
        ):
            return text
        return text.replace("terms.", f"groups.{group}.", 1)

    def terms_of(self, group: str | None) -> dict[str, PatchTerm]:
        """Return the terms shared by all groups, and those of one group."""
        if group is None:
            return self.terms
        return {**self.terms, **(self.groups or {})[group]}


@dataclass(frozen=True)
class Patch:
    """A patch and where it was read from."""

    model: ModelPatch  # with the terms of one group, if it has groups
    path: Path | None = None  # None: from a recording
    group: str | None = None  # the chosen group
    of_group: frozenset[str] = frozenset()  # terms that belong to this group only

    @property
    def sha256(self) -> str:
        """Hash of the content, without comments and order of the file."""
        text = json.dumps(self._content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def provenance(self) -> dict[str, Any]:
        """For recordings: enough to lay the patch over its configuration again."""
        return {"sha256": self.sha256, "content": self._content}

    @property
    def _content(self) -> dict[str, Any]:
        without = {"groups"} if self.model.parameters else {"groups", "parameters"}
        return self.model.model_dump(mode="json", by_alias=True, exclude=without)

    @property
    def values(self) -> dict[str, float]:
        """Its values by the full names of the parameters; NaN is null."""
        terms = {
            f"{TERM}{main_part(n)}": term.value for n, term in self.model.terms.items()
        }
        parameters = {n: _number(p.value) for n, p in self.model.parameters.items()}
        return terms | parameters

    @property
    def parameters(self) -> dict[str, float]:
        """Values that schema 2 adds to the terms, without those of own blocks."""
        own = self.model.parameters
        return {
            named(n, PLANT): v
            for n, v in self.values.items()
            if n in own and n in PLANT
        }

    def applied(self, plant: PlantConfig) -> PlantConfig:
        """Return the plant with the terms of the patch, but not its `parameters`.

        ConfigError if the configuration sets one of the terms itself.
        """
        set_there = {
            main_part(n) for n, value in plant.terms.items() if value is not None
        }
        added: dict[str, float | None] = {}
        for name, term in self.model.terms.items():
            if main_part(name) in set_there:
                raise self.refusal(
                    name,
                    "the configuration sets this term as well (plant.terms); remove it from one of"
                    " them",
                )
            added[main_part(name)] = term.value
        kept = {n: v for n, v in plant.terms.items() if main_part(n) not in added}
        return plant.changed(terms={**kept, **added})

    def entry_at(self, key: str) -> str | None:
        """Return the entry of the patch for a key of the configuration, if there is one."""
        name = key.removeprefix("plant.terms.").removeprefix(TERM)
        own = next((n for n in self.model.terms if name in (n, main_part(n))), None)
        if own is not None:
            return own
        return next(
            (n for n in self.model.parameters if n in (key, f"{TERM}{name}")), None
        )

    def refusal(self, entry: str, message: str) -> ConfigError:
        """Return the error for a complaint about one entry: file, line, key."""
        section = "parameters" if entry in self.model.parameters else "terms"
        where: tuple[str, ...]
        if entry in self.of_group:
            where = ("groups", self.group or "", entry)
        else:
            where = (section, entry)
        return ConfigError(place(self.path, where) + message)

    def notice(self, config_sha256: str) -> str | None:
        """Return a warning if the patch was made for another configuration."""
        if self.model.made_from.config_sha256 == config_sha256:
            return None
        made_for = self.model.made_from.config_sha256[:12]
        return (
            f"{self.path or 'the patch'}: was fitted to another configuration"
            f" ({made_for}, this one is {config_sha256[:12]});"
            " its terms may not fit"
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def load_patch(path: Path, group: str | None = None) -> Patch:
    """Read a patch, or one of its groups; ConfigError has one line per complaint."""
    model = load(path, ModelPatch, LIVE_BYTES)
    groups = model.groups or {}
    names = ", ".join(groups)
    if group is None and groups:
        raise ConfigError(f"{path}: differs by group; choose one with --group: {names}")
    if group is not None and not groups:
        raise ConfigError(f"{path}: has no groups; leave --group {group} out")
    if group is None:
        return Patch(model, path)
    if group not in groups:
        raise ConfigError(f"{path}: has no group '{group}'; it has {names}")
    taken = model.changed(terms=model.terms_of(group), groups=None)
    return Patch(taken, path, group, frozenset(groups[group]))


def patch_of(run: Mapping[str, Any]) -> Patch | None:
    """Return the patch of the run of a recording.

    ValueError if it is not one of this version.
    """
    recorded = run.get("patch")
    if recorded is None:
        return None
    return Patch(ModelPatch.model_validate(recorded["content"]))
