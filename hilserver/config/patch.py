"""`model_patch.yaml`: terms that a diagnosis has found, and where they were fitted.

A patch is laid over the configuration for one run. Nothing of it is written into config.yaml: a run
without it gives the old outputs, bit for bit.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hilserver.config.loading import load, place
from hilserver.config.plant import PlantConfig
from hilserver.errors import ConfigError
from hilserver.plant.errors import PlantError
from hilserver.plant.terms import TERMS, complete, main_part

SCHEMA: Final = "hilserver.model_patch/1"
Interval = tuple[float, float]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MadeFrom(_Model):
    """Where a patch comes from."""

    findings_sha256: str = Field(description="hash of the findings.json next to it")
    config_sha256: str = Field(description="hash of the configuration that was diagnosed")
    version: str = Field(description="version of hilserver that made it")


class FittedIn(_Model):
    """What the machine did in the data; null: not excited, then nothing is said about it."""

    speed_m_s: Interval | None = Field(None, description="smallest and largest speed, with sign")
    wheel_speed_rpm: Interval | None = Field(None, description="of all wheels, with sign")
    turn_rate_rad_s: Interval | None = Field(None, description="smallest and largest, with sign")
    voltage_v: Interval | None = Field(None, description="of the battery")
    conditions: str = Field("", description="logs, duration and rate, in words")

    @field_validator("speed_m_s", "wheel_speed_rpm", "turn_rate_rad_s", "voltage_v")
    @classmethod
    def _rises(cls, value: Interval | None) -> Interval | None:
        if value is not None and value[0] > value[1]:
            raise ValueError(f"{value[0]:g} .. {value[1]:g} falls; swap the two numbers")
        return value


class PatchTerm(_Model):
    """One term."""

    value: float = Field(description="value of the term, in its unit")
    unit: str = Field(description="symbol of the unit, as in the table of terms")
    ci95: Interval | None = Field(None, description="interval of 95 %")
    fitted_in: FittedIn = Field(default_factory=FittedIn, description="where it was fitted")


class ModelPatch(_Model):
    """The file."""

    schema_: Literal["hilserver.model_patch/1"] = Field(alias="schema", description="this format")
    made_from: MadeFrom
    terms: dict[str, PatchTerm] = Field(description="terms by name, as in plant.terms")

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True
    )

    @model_validator(mode="after")
    def _known_terms(self) -> Self:
        try:
            complete({name: term.value for name, term in self.terms.items()})
        except PlantError as error:
            raise ValueError(str(error).removeprefix("plant.")) from None
        for name, term in self.terms.items():
            unit = TERMS[main_part(name)].unit
            if term.unit != unit:
                raise ValueError(f"terms.{name}.unit: the term has the unit {unit!r}")
        return self


@dataclass(frozen=True)
class Patch:
    """A patch and where it was read from; None: from a recording."""

    model: ModelPatch
    path: Path | None = None

    @property
    def sha256(self) -> str:
        """Hash of what it says; comments and order of the file do not count."""
        text = json.dumps(self.model.model_dump(mode="json", by_alias=True), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def provenance(self) -> dict[str, Any]:
        """What a recording carries, enough to lay the patch over its configuration again."""
        content = self.model.model_dump(mode="json", by_alias=True)
        return {"sha256": self.sha256, "content": content}

    def applied(self, plant: PlantConfig) -> PlantConfig:
        """Return the plant with the terms of the patch.

        Raises
        ------
        ConfigError
            If the configuration sets one of the terms itself.
        """
        set_there = {main_part(n) for n, value in plant.terms.items() if value is not None}
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
        return plant.model_copy(update={"terms": {**kept, **added}})

    def term_at(self, key: str) -> str | None:
        """Return the term of the patch that a key of the configuration names, if it is one."""
        name = key.removeprefix("plant.terms.")
        return next((n for n in self.model.terms if name in (n, main_part(n))), None)

    def refusal(self, term: str, message: str) -> ConfigError:
        """Return the error for a complaint about one term: file, line, key."""
        return ConfigError(place(self.path, ("terms", term)) + message)

    def notice(self, config_sha256: str) -> str | None:
        """Return a warning if the patch was made for another configuration."""
        if self.model.made_from.config_sha256 == config_sha256:
            return None
        return (
            f"{self.path or 'the patch'}: was fitted to another configuration"
            f" ({self.model.made_from.config_sha256[:12]}, this one is {config_sha256[:12]});"
            " its terms may not fit"
        )


def load_patch(path: Path) -> Patch:
    """Read a patch.

    Raises
    ------
    ConfigError
        One line per complaint: file, line and key.
    """
    return Patch(load(path, ModelPatch), path)


def patch_of(run: Mapping[str, Any]) -> Patch | None:
    """Return the patch that a recording says its run had.

    Raises
    ------
    ValueError
        If it is not one of this version.
    """
    recorded = run.get("patch")
    return None if recorded is None else Patch(ModelPatch.model_validate(recorded["content"]))


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of model_patch.yaml."""
    schema = ModelPatch.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
