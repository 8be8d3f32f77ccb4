"""What a diagnosis writes to its folder: findings.json, report.html, model_patch.yaml."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from hilserver.diagnosis.findings.patch import as_yaml, make_patch
from hilserver.diagnosis.for_others import older_files
from hilserver.diagnosis.report import render
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Findings
from hilserver.errors import FailedError
from hilserver.program.whole_file import write_whole

FINDINGS: Final = "findings.json"
REPORT: Final = "report.html"
PATCH: Final = "model_patch.yaml"
TRIED: Final = ("power.csv", "power.json")


def findings_text(findings: Findings) -> str:
    """Return the text of findings.json."""
    plain = _rounded(findings.model_dump(mode="json", by_alias=True))
    return json.dumps(plain, indent=1, ensure_ascii=False) + "\n"


def _rounded(value: Any) -> Any:
    """Return plain data with numbers of nine digits, and null for NaN and infinity.

    The last digits of a sum depend on how many threads add it up.
    """
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def documents(diagnosis: Diagnosis) -> dict[str, str]:
    """Return the text of every file by its name; findings.json is the last."""
    named = PATCH if diagnosis.evidence.extension else None
    findings = diagnosis.findings.model_copy(update={"model_patch": named})
    text = findings_text(findings)
    patch = make_patch(diagnosis, hashlib.sha256(text.encode()).hexdigest())
    files = {REPORT: render(findings, diagnosis.evidence)}
    if patch is not None:
        files[PATCH] = as_yaml(patch)
    return files | {FINDINGS: text}


def write(folder: Path, files: Mapping[str, str]) -> None:
    """Write the files, each whole or not at all; those of an older run are removed.

    Raises
    ------
    FailedError
        If the folder cannot be written.
    """
    write_files(folder, files, (FINDINGS, PATCH, REPORT, *TRIED, *older_files(folder)))


def write_files(
    folder: Path, files: Mapping[str, str], known: Sequence[str] = ()
) -> None:
    """Write files, each whole or not at all; remove `known` ones that are not written.

    Raises
    ------
    FailedError
        If the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in known:
            if name not in files:
                (folder / name).unlink(missing_ok=True)
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_whole(folder / name, text.encode())
    except OSError as error:
        raise FailedError(
            f"{folder}: {(error.strerror or str(error)).lower()}"
        ) from None
