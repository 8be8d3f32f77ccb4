"""A machine as a configuration, with which ``hilserver run`` simulates that machine."""

from math import isnan
from pathlib import Path
from typing import Any

from hilserver.config.root import Config, without_passwords
from hilserver.parameters.table import BLOCK, TERM
from hilserver.plant.terms import TERMS, complete
from hilserver.sweep.prepare import SentMachine


def machine_config(
    config: Config, folder: Path, machine: SentMachine
) -> dict[str, Any]:
    """Return the configuration of a machine as plain data; its paths are absolute."""
    data = without_passwords(config)
    terms = {n: v for n, v in complete(machine.terms).items() if v != TERMS[n].null}
    data["peers"] = []  # the scenario drives
    data["plant"] |= {"terms": terms, "seed": machine.seed}
    for name, value in machine.values.items():
        if name.startswith(BLOCK):
            block, _, key = name.removeprefix(BLOCK).partition(".")
            use = next(one for one in data["blocks"] if one["name"] == block)
            use["parameters"][key] = value
        elif not name.startswith(TERM):
            *sections, key = name.split(".")
            place = data
            for section in sections:
                place = place[section]
            place[key] = None if isnan(value) else value
    for use in data["blocks"]:
        file, colon, function = (use["function"] or "").rpartition(":")
        if file.endswith(".py"):
            use["function"] = f"{(folder / file).resolve()}{colon}{function}"
    hall = data["sensors"]["tof"]
    if hall["hall"] != "default":
        hall["hall"] = str((folder / hall["hall"]).resolve())
    return data
