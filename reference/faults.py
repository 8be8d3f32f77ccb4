"""The page of all faults, made from the model."""

from hilserver.faults.model import FORMS, PARAMETERS, Fault
from hilserver.kernel.modifier_layout import MAX_DELAY_TICKS, MAX_MODIFIERS, MAX_RINGS

HEAD = """# Faults: every kind and every key

Made from the code by `make reference`; a test keeps it up to date. How to use
them: [faults and scenarios](../how-to/faults-and-scenarios.md).

| fault | acts on | needs | takes | what happens |
|---|---|---|---|---|
"""

KEYS = """
## Keys

| key | default | meaning |
|---|---|---|
"""

RULES = f"""
## Rules

- A fault acts at the start of a tick on inputs (after they are latched) and before publication on
  outputs. Plant, sensors and own blocks compute with the true outputs: a lie about the pose does not
  move the robot. When a fault ends, the true value is there again in that tick.
- Several faults on one signal act in the order in which they came; forces act last.
- `force` is visible: status GoodLocalOverride, `faults.forced.names`, metric `hil_faults`, log. The
  safe state wins over a force: set-points ramp to zero and the drive is off, whatever is forced.
- Whole-numbered signals stay whole and in their range. No fault can change `sim.*`.
- The same seed at the same tick gives the same number, in every pacing back end, and also after a
  snapshot, which holds all faults with their memory. Reset ends all faults and forces.
- At most {MAX_MODIFIERS} scalars are modified at once, {MAX_RINGS} of them delayed by at most
  {MAX_DELAY_TICKS} ticks.
- Faults of a peer link run on the event loop in wall time, with bounded queues; they delay or lose
  whole batches and leave the link's own heartbeat alone. `disconnect` ends the session and keeps it
  from coming back.
- `shield.dead_command_timeout` defeats `control.command_timeout_ms`, `opcua_stale_after_ms` and what
  a peer's `on_stale` does. `shield.last_wheel_scaling` shows only when both sides are too fast,
  which the ranges of the twist prevent: give `value` a limit below `max_rpm`.
"""


def as_markdown() -> str:
    """Return the reference as Markdown."""
    rows = [
        f"| `{kind}` | {', '.join(form.on) or 'the shield'} | {_keys(form.needs)} |"
        f" {_keys(form.takes)} | {form.text} |"
        for kind, form in FORMS.items()
    ]
    keys = [
        f"| `{name}` | {_default(name)} | {field.description or ''} |"
        for name, field in Fault.model_fields.items()
        if field.description or name in PARAMETERS
    ]
    return HEAD + "\n".join(rows) + "\n" + KEYS + "\n".join(keys) + "\n" + RULES


def _keys(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _default(name: str) -> str:
    field = Fault.model_fields[name]
    if field.is_required():
        return "needed"
    return "" if field.default is None else f"`{field.default}`"
