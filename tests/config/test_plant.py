"""The plant's parameters and the keys of the configuration are the same."""

from dataclasses import fields

import pytest

from hilserver.body.parameters import BodyParameters, Tyre
from hilserver.config import mechatronic, plant
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.parts import (
    Battery,
    Controller,
    Imu,
    Navigation,
    Process,
    RangeFinders,
)

PAIRS = [
    (plant.PlantConfig, RobotParameters),
    (plant.ControllerConfig, Controller),
    (plant.ProcessConfig, Process),
    (plant.ImuConfig, Imu),
    (plant.BatteryConfig, Battery),
    (plant.TofConfig, RangeFinders),
    (plant.NavConfig, Navigation),
    (mechatronic.TyreConfig, Tyre),
    (mechatronic.MechatronicConfig, BodyParameters),
]
OF_THE_SLICE = {"period_s", "slice_s", "step_s"}


@pytest.mark.parametrize(("section", "part"), PAIRS)
def test_every_quantity_has_its_key_with_default_and_meaning(section, part):
    for item in fields(part):
        if "meaning" not in item.metadata or item.name in OF_THE_SLICE:
            continue
        key = section.model_fields[item.name]
        assert key.default == item.default
        unit = item.metadata["unit"]
        assert key.description == item.metadata["meaning"] + (
            f" [{unit}]" if unit else ""
        )
        assert len(key.metadata) == len(item.metadata["bounds"])


@pytest.mark.parametrize(("section", "part"), PAIRS)
def test_no_number_is_without_bounds(section, part):
    numbers = [item for item in fields(part) if isinstance(item.default, float)]
    assert all(item.metadata.get("bounds") for item in numbers)
