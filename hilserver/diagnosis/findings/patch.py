"""From a diagnosis to `model_patch.yaml`, which `hilserver run --patch` loads."""

from collections.abc import Mapping

import yaml

from hilserver.config.patch import SCHEMA, MadeFrom, ModelPatch, PatchTerm
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import InGroup, Parameter

_HEAD = """\
# Terms fitted by 'hilserver diagnose'. Run the extended model with
#   hilserver run --patch model_patch.yaml
# Outside the ranges below, outputs changed by a term are flagged Uncertain.
"""
_WITH_GROUP = "model_patch.yaml --group NAME"
MAX_NAMES = 3


def make_patch(diagnosis: Diagnosis, findings_sha256: str) -> ModelPatch | None:
    """Return the extension as a patch, or None when there is none.

    Parameters
    ----------
    diagnosis : Diagnosis
        Its evidence holds the fitted terms and the range of the data.
    findings_sha256 : str
        Hash of the findings.json that is written next to it.
    """
    findings, evidence = diagnosis.findings, diagnosis.evidence
    if not evidence.extension:
        return None
    fitted = evidence.fitted.model_copy(update={"conditions": _conditions(diagnosis)})
    terms: dict[str, PatchTerm] = {}
    groups: dict[str, dict[str, PatchTerm]] = {}  # of the terms that differ
    for term in evidence.extension:
        p = term.parameter
        by_group: Mapping[str, Parameter | InGroup] = p.groups or {"": p}
        for group, own in by_group.items():
            place = groups.setdefault(group, {}) if group else terms
            place[term.name] = PatchTerm(
                value=own.value, unit=p.unit, ci95=own.ci95, fitted_in=fitted
            )
    return ModelPatch(
        schema_=SCHEMA,
        made_from=MadeFrom(
            findings_sha256=findings_sha256,
            config_sha256=findings.config_sha256,
            version=findings.version,
        ),
        terms=terms,
        groups=groups or None,
    )


def _conditions(diagnosis: Diagnosis) -> str:
    names = [log.file for log in diagnosis.findings.logs]
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    logs = ", ".join(names[:MAX_NAMES]) + more
    said = diagnosis.evidence.fitted.conditions
    return f"{logs}: {said}" if said else logs


def as_yaml(patch: ModelPatch) -> str:
    """Return the patch as the text of its file."""
    own = {"parameters"}  # of schema 2: what a user has tuned
    data = patch.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=own)
    head = (
        _HEAD
        if patch.groups is None
        else _HEAD.replace("model_patch.yaml", _WITH_GROUP, 1)
    )
    return head + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
