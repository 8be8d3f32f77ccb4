"""A plan as a page: what the manoeuvre can show, what a better one can, and how to drive it."""

from hilserver.diagnosis.plan.document import PlanDocument
from hilserver.diagnosis.report.page import environment
from hilserver.diagnosis.report.tables import by_reason

PAGE = "plan.html"


def render_plan(document: PlanDocument) -> str:
    """Return a plan as one HTML file without any reference to the network."""
    proposed = document.proposed
    first, second = (
        {v.cause: v for v in p.causes} for p in (document.as_planned, proposed)
    )
    return (
        environment()
        .get_template("plan.html.j2")
        .render(
            plan=document,
            headline=_headline(document),
            seen=[
                (first.get(c), second.get(c)) for c in dict.fromkeys((*first, *second))
            ],
            pieces={name: proposed.pieces.count(name) for name in proposed.pieces},
            unjudged=by_reason(proposed.not_judged),
        )
    )


def _headline(document: PlanDocument) -> str:
    both = document.as_planned, document.proposed
    shown, then = (sum(v.shows for v in prospect.causes) for prospect in both)
    if not document.proposed.better:
        return (
            f"{document.manoeuvre} shows {shown} causes; no better manoeuvre was found."
        )
    return f"{document.manoeuvre} shows {shown} causes; the proposed manoeuvre shows {then}."
