"""A sweep as a test report: one test case per requirement."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from hilserver.sweep.estimates import exact_interval
from hilserver.sweep.table import REFUSED, MachineTable


def write_junit(path: Path, table: MachineTable) -> None:
    """Write a test suite; a requirement that too few machines meet fails."""
    driven = np.array([status != REFUSED for status in table.status], dtype=bool)
    shares = table.about["shares"]
    name = str(table.about["sweep"])
    cases = []
    failures = 0
    for requirement, margins in table.margins.items():
        met = int((margins[driven] >= 0.0).sum())
        n = int(driven.sum())
        low, high = exact_interval(met, n)
        case = ET.Element("testcase", classname=name, name=requirement)
        share = met / max(n, 1)
        text = f"{met} of {n} machines meet it: {share:.4f} ({low:.4f} .. {high:.4f})"
        if met < shares[requirement] * n or n == 0:
            failures += 1
            failure = ET.SubElement(case, "failure", message=text)
            known = np.where(np.isnan(margins), -np.inf, margins)
            order = np.argsort(known, kind="stable")
            lines = []
            for row in order[:10].tolist():
                if table.status[row] != REFUSED:
                    why = table.message[row] or f"margin {margins[row]:g}"
                    lines.append(f"machine {table.index[row]}: {why}")
            failure.text = "\n".join(lines)
        else:
            ET.SubElement(case, "system-out").text = text
        cases.append(case)
    suite = ET.Element(
        "testsuite", name=name, tests=str(len(cases)), failures=str(failures)
    )
    suite.extend(cases)
    ET.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)
