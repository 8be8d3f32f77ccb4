"""What all sections of the configuration have in common."""

import json
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, Self, cast

from pydantic import BaseModel, ConfigDict, Field

from hilserver.signals import Source


class Section(BaseModel):
    """A section of config.yaml: unknown keys are errors, nothing changes after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def changed(self, **values: Any) -> Self:
        """Return a copy with other values, which are not checked.

        A mapping changes a section inside: ``config.changed(page={"port": 0})``.
        """
        update = {}
        for name, value in values.items():
            old = getattr(self, name)
            within = isinstance(old, Section) and isinstance(value, dict)
            update[name] = old.changed(**value) if within else value
        return self.model_copy(update=update)


class Driver(NamedTuple):
    """A source that may drive over a link."""

    name: str  # in log, metrics and OPC UA
    source: str  # name under which it writes; the part before a colon is its kind
    title: str  # in messages
    limit_ms: float  # how long a command holds without renewal
    on_stale: str  # what happens to it then
    is_enabled: bool = True
    has_faults: bool = True  # whether faults can be injected
    lapse: str = ""  # what the step does then, if it has another name for it

    @property
    def kind(self) -> Source:
        """Its kind in the ranking of sources: ``peer``."""
        return cast("Source", self.source.partition(":")[0])

    @property
    def policy(self) -> str:
        """What the step does when its lease lapses."""
        return self.lapse or self.on_stale


class LinkSection(Section):
    """A section that lets somebody drive; leases, messages and faults follow from its `driver`."""

    @property
    def driver(self) -> Driver:
        """The source that drives over it."""
        raise NotImplementedError

    @property
    def drives(self) -> bool:
        """Whether it can command, so that its kind has control at the start."""
        return self.driver.is_enabled

    def about(self, _folder: Path) -> str:
        """Return its line in `hilserver check`; empty: off. Paths are relative to the folder."""
        return "on" if self.driver.is_enabled else ""


def need(module: str, extra: str, who: str) -> None:
    """Raise if the extra of a section is not installed; `who`: what needs which library."""
    if find_spec(module) is None:
        raise ValueError(
            f"{who}: install it with \"pip install 'hilserver[{extra}]'\", or set enabled: false"
        )


def schema_text(model: type[BaseModel]) -> str:
    """Return the JSON Schema of a file for editors."""
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(about | model.model_json_schema(), indent=1) + "\n"


def of(part: type, name: str) -> Any:
    """Return a field with the default, bounds and meaning of the plant's parameter."""
    (item,) = (one for one in fields(part) if one.name == name)
    about = item.metadata
    unit = f" [{about['unit']}]" if about["unit"] else ""
    return Field(item.default, description=about["meaning"] + unit, **about["bounds"])
