/** The card of the recalibration: what was found, what is proposed, and the decision. */

import { may, type Context } from "../context";
import { call, type Board, type Gain, type Proposal } from "../net";
import { action, h, number } from "../ui";

const LOOKS: Record<string, string> = {
  nothing: "The last window fits the model.",
  as_running: "The last window fits the running model.",
  named: "A cause was named on the last window; the next one has to confirm it.",
  too_small: "The last window shows a change that is too small to propose.",
  unexplained: "The last window shows something that no known cause explains.",
  data_fault: "The data of the last window are faulty; nothing is proposed.",
  not_judged: "The last window is not conclusive: more motion or more channels are needed.",
  confirmed: "Confirmed on an independent window.",
  not_confirmed: "The named cause was not confirmed on the next window.",
  no_test: "The named cause could not be tested: the next window is not conclusive.",
  known: "The same cause was named again; it is already decided or awaits a decision.",
  proposal: "A cause was named and confirmed on an independent window: please decide.",
  accepted: "The patch is active; the next full window will show whether the gap has shrunk.",
  rejected: "The proposal is rejected and will not be made again.",
  postponed: "The proposal is postponed.",
  better: "The gap has shrunk.",
  not_better: "The gap has not shrunk.",
  too_short: "The robot moved too little to show whether the gap has shrunk; the next window may.",
};
/** Verdicts whose sentence says more than a proposal does. */
const SAID = ["named", "too_small", "unexplained", "no_test", "too_short"];
const STAGES: Record<string, string> = { not_better: "not better", accepted: "accepted, being measured" };

/** Return the card, and what shows a board in it. */
export function proposalCard(context: Context): { element: HTMLElement; show: (board: Partial<Board>) => void } {
  const look = h("p", { class: "hint", role: "status" });
  const why = h("p", { class: "note" });
  const body = h("div", {});
  const element = h("section", { class: "panel", "aria-label": "Recalibration", hidden: true }, h("h2", {}, "Recalibration"), look, why, body);
  let shown = "";
  function show(board: Partial<Board>): void {
    const now = board.recalibration;
    element.hidden = !now;
    const text = JSON.stringify(now ?? null);
    if (!now || text === shown) return;
    shown = text;
    look.textContent = said(now.look);
    why.textContent = SAID.includes(String(now.look["verdict"])) ? String(now.look["sentence"]) : "";
    why.hidden = !why.textContent;
    body.replaceChildren(now.proposal ? proposed(context, now.proposal) : h("p", { class: "note" }, "No proposal yet."));
  }
  return { element, show };
}

function said(look: Record<string, string | number | boolean>): string {
  if (look["is_looking"]) return "A window is being diagnosed.";
  if (look["gap_changed"]) return "The gap has left its usual range; the next window will be diagnosed.";
  return String(LOOKS[String(look["verdict"] || (look["kind"] === "proposal" && "proposal"))] ?? look["sentence"] ?? "") || "The first window is being recorded.";
}

function proposed(context: Context, p: Proposal): HTMLElement {
  const waits = p.stage === "open" || p.stage === "postponed";
  const decide = (label: string, method: string, first = false) =>
    action(label, () => call(method, p.number), { disabled: !may(context, method), class: first ? "primary" : "" });
  const measured = Object.keys(p.effect).length > 0;
  return h("div", {},
    h("div", { class: "job-head" }, h("b", {}, `Proposal ${p.number}`), h("span", { class: "chip" }, STAGES[p.stage] ?? p.stage)),
    h("p", {}, p.sentence),
    h("dl", { class: "pairs" },
      ...Object.entries(p.terms).map(([name, t]) => pair(name, `${t.present === null ? "off" : number(t.present)} → ${number(t.value)} ${t.unit === "1" ? "" : t.unit}${t.ci95 ? ` (${number(t.ci95[0])} to ${number(t.ci95[1])})` : ""}`)),
      ...Object.entries(p.gone).map(([name, value]) => pair(name, `${number(value)} → off`))),
    h("p", { class: "hint" }, measured ? "Gap before and after, measured since the decision" : `Gap before and after on window ${p.windows[p.windows.length - 1]}, which was not used to find it`),
    h("dl", { class: "pairs", "data-gain": measured ? "effect" : "gain" }, ...rows(measured ? p.effect : p.gain)),
    waits && h("div", { class: "buttons" }, decide("Accept", "AcceptProposal", true), decide("Reject", "RejectProposal"), p.stage === "open" && decide("Postpone", "PostponeProposal")),
  );
}

function rows(gain: Record<string, Gain>): HTMLElement[] {
  return Object.entries(gain)
    .sort(([, a], [, b]) => b.ratio - a.ratio)
    .map(([name, q]) => pair(name, `${number(q.before)} → ${number(q.after)} (${q.ratio.toFixed(1)}×)`));
}

function pair(name: string, value: string): HTMLElement {
  return h("div", {}, h("dt", {}, name), h("dd", {}, value));
}
