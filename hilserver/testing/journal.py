"""What a test did and when, so that a failure can be repeated as a scenario."""

from collections.abc import Mapping
from typing import Any

from hilserver.faults.model import Fault
from hilserver.faults.scenario import MAX_STEPS


class Journal:
    """Writes and faults of one test, in their order."""

    def __init__(self) -> None:
        self.left_out = 0
        self._steps: list[dict[str, Any]] = []
        self._faults: list[dict[str, Any]] = []

    def wrote(self, at_s: float, values: Mapping[str, Any], key: str = "write") -> None:
        """Note values that the tick at `at_s` latches, signals or parameters (``set``)."""
        if len(self._steps) >= MAX_STEPS:
            self.left_out += 1
            return
        self._steps.append({"at_s": round(at_s, 9), key: dict(values)})

    def injected(self, at_s: float, fault: Fault) -> None:
        """Note a fault, whose times count from `at_s`."""
        entry = fault.model_dump(exclude_none=True, exclude_defaults=True)
        entry.pop("for_s", None)
        entry["from_s"] = round(at_s + fault.from_s, 9)
        if fault.end_s is not None:
            entry["until_s"] = round(at_s + fault.end_s, 9)
        self._faults.append(entry | {"name": fault.title, "seed": fault.seed or 0})

    def cleared(self, at_s: float, name: str | None) -> None:
        """Note the end of a fault, or of all except forces."""
        for entry in self._faults:
            is_meant = (
                entry["fault"] != "force" if name is None else entry["name"] == name
            )
            if is_meant and entry.get("until_s", at_s + 1.0) > at_s > entry["from_s"]:
                entry["until_s"] = round(at_s, 9)

    def scenario(self, text: str, seed: int) -> dict[str, Any]:
        """Return everything as a scenario in plain data."""
        if self.left_out:
            text += f"; the last {self.left_out} writes are left out"
        faults = self._faults
        return {
            "scenario": text[:200],
            "seed": seed,
            "steps": self._steps,
            "faults": faults,
        }
