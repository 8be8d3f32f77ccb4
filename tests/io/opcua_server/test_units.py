"""Unit codes against the numbers that OPC 10000-8 and UNECE publish."""

import pytest

from hilserver.errors import ConfigError
from hilserver.io.opcua_server.units import UNECE, find_unit, unit_id
from hilserver.signals import Ranges, robot_table


@pytest.mark.parametrize(
    ("symbol", "code", "number"),
    [
        # UnitIds as the OPC Foundation lists them in UNECE_to_OPCUA.csv.
        ("m", "MTR", 5067858),
        ("m/s", "MTS", 5067859),
        ("m/s²", "MSK", 5067595),
        ("rpm", "RPM", 5394509),
        ("rad", "C81", 4405297),
        ("rad/s", "2A", 12865),
        ("V", "VLT", 5655636),
        ("%", "P1", 20529),
        ("s", "SEC", 5457219),
        ("1", "C62", 4404786),
        ("°C", "CEL", 4408652),
    ],
)
def test_published_unit_ids(symbol: str, code: str, number: int) -> None:
    unit = UNECE[symbol]
    assert (unit.code, unit.unit_id) == (code, number)


def test_codes_and_symbols_are_unique() -> None:
    codes = [unit.code for unit in UNECE.values()]
    assert len(set(codes)) == len(codes)
    assert all(unit.unit_id == unit_id(unit.code) for unit in UNECE.values())
    assert all(unit.symbol == symbol for symbol, unit in UNECE.items())


def test_unknown_unit_is_one_sentence() -> None:
    assert find_unit("m") is UNECE["m"]
    with pytest.raises(
        ConfigError, match="unit 'parsec' is unknown; write one of 1, %"
    ):
        find_unit("parsec")


def test_every_signal_has_a_known_unit() -> None:
    table = robot_table(Ranges(90.0, 0.8, 3.0), body=True)
    assert {signal.unit for signal in table.scalars} <= UNECE.keys()


def test_every_unit_of_a_signal_has_a_code():
    table = robot_table(Ranges(1.0, 1.0, 1.0), body=True, observer=True)
    for signal in table:
        assert find_unit(signal.unit).unit_id
