"""Figures are printed beside the speed of the computer they were measured on."""

import json
import re

from hilserver.bench.report import Result, as_json, as_table

FOUND = [Result("cost", 3.0, "us", 6.0, "another", 0.5), Result("alone", 1.0, "1")]


def test_a_table_ends_with_the_speed_of_the_computer():
    head, cost, alone, speed = as_table(FOUND).splitlines()
    assert head.split() == [
        "figure",
        "value",
        "unit",
        "reference",
        "ratio",
        "reference",
        "is",
    ]
    assert cost.split() == ["cost", "3", "us", "6", "0.50", "another"]
    assert alone.split() == ["alone", "1", "1"]
    assert 0.01 < float(re.search(r"take (\d+\.\d\d) s", speed)[1]) < 1000.0


def test_the_document_holds_it_too():
    document = json.loads(as_json(FOUND))
    assert 0.01 < document["machine"]["loop_s"] < 1000.0
    assert [one["name"] for one in document["results"]] == ["cost", "alone"]
