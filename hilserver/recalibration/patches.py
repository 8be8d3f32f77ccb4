"""The patch files of a proposal: the proposed model, and the one before it."""

import math
from pathlib import Path

import yaml

from hilserver import __version__
from hilserver.config.patch import (
    SCHEMA,
    SCHEMA_2,
    FittedIn,
    MadeFrom,
    ModelPatch,
    PatchParameter,
    PatchTerm,
)
from hilserver.errors import FailedError, reason
from hilserver.parameters import PLANT
from hilserver.parameters.table import TERM, Parameter
from hilserver.program.whole_file import write_whole
from hilserver.recalibration.loop import present
from hilserver.recalibration.orders import Values
from hilserver.recalibration.proposals import Proposal, ProposedTerm


def split(values: Values) -> tuple[dict[str, float], dict[str, float]]:
    """Split parameters into terms, by their own names, and all others."""
    terms = {n.removeprefix(TERM): v for n, v in values.items() if n.startswith(TERM)}
    return terms, {n: v for n, v in values.items() if not n.startswith(TERM)}


def write(folder: Path, proposal: Proposal, others: Values, config_sha256: str) -> None:
    """Write the two patches of a proposal: the change, and the way back.

    Parameters
    ----------
    others : mapping of float
        Parameters other than terms that differ from the configuration; both patches keep them.

    Raises
    ------
    FailedError
        If they cannot be written.
    """
    before = {n: ProposedTerm(v, _of(n).unit) for n, v in present(proposal).items()}
    made_from = MadeFrom(config_sha256=config_sha256, version=__version__)
    for name, terms, off in (
        (proposal.patch, proposal.terms, proposal.gone.keys()),
        (proposal.former, before, proposal.terms.keys() - before.keys()),
    ):
        if others or off:
            nulls = {f"{TERM}{n}": _of(n).default for n in off}
            values = {f"{TERM}{n}": t.value for n, t in terms.items()}
            patch = _of_parameters(made_from, {**others, **nulls, **values})
        else:
            # A patch of terms that states where they were fitted.
            where = FittedIn.model_validate(
                {**proposal.fitted, "conditions": "recalibration"}
            )
            found = {
                n: PatchTerm(value=t.value, unit=t.unit, ci95=t.ci95, fitted_in=where)
                for n, t in terms.items()
            }
            patch = ModelPatch(schema_=SCHEMA, made_from=made_from, terms=found)
        data = patch.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        path = folder / name
        text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, text.encode())
        except OSError as error:
            raise FailedError(f"{path}: cannot be written: {reason(error)}") from None


def _of(term: str) -> Parameter:
    return PLANT[f"{TERM}{term}"]


def _of_parameters(made_from: MadeFrom, values: Values) -> ModelPatch:
    """Return a patch of any parameters, which can also switch terms off."""
    found = {
        n: PatchParameter(value=None if math.isnan(v) else v, unit=PLANT[n].unit)
        for n, v in values.items()
        if n in PLANT
    }
    return ModelPatch(schema_=SCHEMA_2, made_from=made_from, parameters=found)
