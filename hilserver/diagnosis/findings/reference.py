"""The reference of findings: ``python -m hilserver.diagnosis.findings.reference``."""

from hilserver.diagnosis.catalogue.vocabulary import CAUSES, Cause
from hilserver.diagnosis.findings.explain import experiments, sentences

HEAD = """# Findings: what a diagnosis writes

Made from the code by `python -m hilserver.diagnosis.findings.reference`; a test keeps it up to
date.

`hilserver diagnose` writes three files into its folder:

| file | for | schema |
|---|---|---|
| `report.html` | people; opens without a network | |
| `findings.json` | programs | `hilserver.diagnosis/1`, \
`hilserver/diagnosis/schema/findings.schema.json` |
| `model_patch.yaml` | `hilserver run --patch`; only where the model can be extended | \
`hilserver.model_patch/1`, `hilserver/diagnosis/schema/model_patch.schema.json` |

Each file appears whole or not at all; `findings.json` comes last, so that the others are there when
it is.

## findings.json

| key | says |
|---|---|
| `verdict` | `findings`, `nothing_found`, `not_judged`; of `--compare` `differs`, `no_difference` |
| `logs`, `seed`, `version`, `config_sha256` | what was judged, by what |
| `baseline` | mean absolute error of the configured plant, data faults corrected |
| `findings` | one entry per finding, below |
| `total_gain` | error at the end of a free run, before and after, on blocks that had no part in \
selection, noise and fit: all three are repeated without each half (of groups: the fit alone); \
causes without a name predict as well, see `decisions` |
| `ceiling` | the ratio that a flexible regression on everything measured reaches |
| `joint` | all fitted `parameters`, `value`, robust `covariance`, in reported units; or null |
| `noise` | by channel `white_sd`, `ou_sd`, `ou_tau_s`, `tail_dof`, `step`, `limits`, below |
| `smallest_detectable` | the smallest effect of each cause that would have shown (weakest limit) |
| `not_judged` | causes that the data say nothing about, and why |
| `notices` | what a reader of the data should know |
| `decisions` | the selection step by step: `cause`, `action`, `reason`, `group`, and \
`held_out_gain`: error before by after on held-out blocks, mean of the quantities; null: not tried |
| `groups` | of `--group`: by group its `logs`, `noise` and `total_gain`; or null |
| `model_patch` | name of the patch beside it, or null |

## A finding

| key | says |
|---|---|
| `verdict` | see below |
| `causes` | one name, or the group that these data cannot tell apart; empty without a known cause |
| `block` | controller, drive, kinematics, navigation, inertial, data or timing |
| `parameters` | value, interval of 95 % and unit by `cause`, `cause.part` or `cause.signal`; \
of an unknown structure, the signal in which it shows most, with its mean deviation |
| `p_adjusted` | probability of chance, all causes counted |
| `explanation`, `separating_experiment` | in words |
| `regressors` | what an unknown structure depends on, strongest first |
| `gain` | as `total_gain`, of this finding alone; 1 where a half by itself does not find it |
| `matters` | of a fitted cause, by channel: `alone` and `with_partners`, below |

| verdict | means |
|---|---|
| `named` | this cause |
| `named_group` | one of these; the data cannot tell which |
| `structure_not_in_library` | something real that no known cause explains; no patch is made of it |
| `drift` | the cause's size changes over the recording |
| `insufficient_excitation` | the robot did not move in a way that shows it |
| `data_fault` | the recording is wrong, not the robot; it was corrected before the rest |
| `differs`, `no_difference` | of `--compare` |

A parameter that differs by group of logs (`--group`) has `groups`: `value` and `ci95` of each, null
where its logs do not show it. Its own `value` is their mean and its `ci95` null. In `joint` it is
called `name@group`, and `noise` is in `groups`.

## What a cause matters

`matters` says by how much the mean absolute error of a channel falls on held-out blocks: without
the cause by with it, all others on (`alone`), and without it and its partners by with them
(`with_partners`). Partners are causes whose estimates are correlated by more than 0.5: when one of
them is left out, the others take over what it explains. The ratios inform; they decide nothing.

## What a channel shows

`noise` describes a channel in its unit: white noise, noise that is correlated over `ou_tau_s`
(Ornstein-Uhlenbeck), Student's t with `tail_dof` degrees of freedom, the `step` that its values are
rounded to, and its `limits`. Null: none (tails: Gaussian).

## model_patch.yaml

No patch is written whose terms, fitted and judged without columns that have no name, make a
reported quantity worse on data that took no part in selection and fit (its whole `ci95` lies
below 1); a notice says so.

Terms by name with value, unit, interval and the range of speed, wheel speed, turn rate and voltage
they were fitted in. `made_from` names findings, configuration and version. A term that the
configuration sets too is refused (exit code 78); another configuration is a warning. Terms that
differ by group of logs are in `groups`: `--group` takes one, and without it the patch is refused.
Outside a range, widened by 2 %, the outputs that the term changes are Uncertain:

| term's block | outputs |
|---|---|
| drive | wheels, pose, velocity, IMU, range finders, navigation |
| kinematics | pose, velocity, IMU, range finders, navigation |
| navigation | navigation |
| inertial | IMU |

## Causes

Null is the value without the effect. Sizes of physical causes are the plant's
[terms](plant.md).

| cause | parameters | unit | null | block | what to do |
|---|---|---|---|---|---|
"""

TWINS = """
## What separates causes

| causes | experiment |
|---|---|
"""


def as_markdown() -> str:
    """Return the reference as Markdown."""
    rows = [_row(cause) for cause in CAUSES.values()]
    pairs = [
        f"| {', '.join(f'`{name}`' for name in sorted(causes))} | {text} |"
        for causes, text in experiments().items()
    ]
    return HEAD + "\n".join(rows) + "\n" + TWINS + "\n".join(pairs) + "\n"


def _row(cause: Cause) -> str:
    parts = [part.name.removeprefix(f"{cause.name}.") for part in cause.parts]
    named = "per signal or source" if cause.by_channel else ", ".join(parts)
    shown = named if len(parts) > 1 or cause.by_channel else ""
    units = ", ".join(dict.fromkeys(part.unit for part in cause.parts))
    nulls = ", ".join(
        "none" if p.null is None else f"{p.null:g}" for p in cause.parts if not p.shape
    )
    remedy = sentences()[cause.name].remedy
    return f"| `{cause.name}` | {shown} | {units} | {nulls} | {cause.block} | {remedy} |"


if __name__ == "__main__":
    print(as_markdown(), end="")
