/** Diagnosis: choose a log, follow the work, read the report, load the patch, see the gap. */

import { may, type Context, type View } from "../context";
import { call, get, live, type Job } from "../net";
import { action, bytes, h, number, setText, svg, toast } from "../ui";

const COURSE = 120; // a minute of boards
const courses = new Map<string, number[]>();

export function diagnosisView(context: Context): View {
  const logs = h("ul", { class: "list" });
  const jobs = h("ul", { class: "jobs" });
  const patches = h("ul", { class: "list" });
  const patch = h("p", { class: "hint", role: "status" });
  const gaps = h("dl", { class: "pairs" });
  const frame = h("iframe", { sandbox: "", title: "Report of the diagnosis", hidden: true });
  const empty = h("p", { class: "note" }, "The report stands here when a diagnosis is done.");
  const units = new Map(context.signals.map((signal) => [signal.name, signal.unit]));

  async function load(): Promise<void> {
    const files = await get<{ logs: { name: string; bytes: number }[]; patches: { name: string }[]; folders: Record<string, string> }>("logs");
    logs.replaceChildren(
      ...(files.logs.length
        ? files.logs.map((log) =>
            h("li", {}, h("code", {}, log.name), h("span", { class: "hint" }, bytes(log.bytes)),
              action("Diagnose", async () => toast(`Diagnosis ${await call("diagnose", log.name)} has started.`), { disabled: !may(context, "Start"), "aria-label": `Diagnose ${log.name}` })))
        : [h("li", { class: "note" }, `No logs yet: record a run, or put one into the folder ${files.folders["recordings"]}.`)]),
    );
    patches.replaceChildren(
      ...(files.patches.length
        ? files.patches.map(({ name }) => h("li", {}, h("code", {}, name), action("Load", () => call("LoadPatch", name), { disabled: !may(context, "LoadPatch"), "aria-label": `Load ${name}` })))
        : [h("li", { class: "note" }, `No patches yet: a diagnosis makes them, or the folder ${files.folders["patches"]} has them.`)]),
    );
  }
  load().catch((error: Error) => toast(error.message, "error"));

  function read(job: Job): void {
    frame.src = `./api/reports/${job.folder}/report.html`;
    frame.hidden = false;
    empty.hidden = true;
  }

  let shown = "";
  function slow(): void {
    const { jobs: told, board } = live.slow;
    const text = JSON.stringify(told);
    if (text !== shown || !jobs.children.length) {
      shown = text;
      jobs.replaceChildren(...(told.length ? told.map((job) => jobItem(job)) : [h("li", { class: "note" }, "No diagnosis yet.")]));
    }
    setText(patch, board.patch ? `${board.patch} is loaded.` : "No patch is loaded.");
    const entries = Object.entries(board.gaps ?? {});
    const none = h("div", {}, h("dt", {}, "No measured values come in."), h("dd", {}, ""));
    gaps.replaceChildren(...(entries.length ? entries.map(([name, gap]) => gapRow(name, gap, units.get(name) ?? "")) : [none]));
  }

  function jobItem(job: Job): HTMLElement {
    const done = job.state === "done";
    return h(
      "li",
      { class: job.state },
      h("div", { class: "job-head" }, h("code", {}, job.log), h("span", { class: "chip" }, job.state)),
      job.state === "running" && h("progress", { max: 1, value: job.share, "aria-label": `Progress of ${job.log}` }),
      job.state === "running" && h("span", { class: "hint" }, `${Math.round(job.share * 100)} % ${job.stage}`),
      job.text && !done && h("pre", { tabindex: "0" }, job.text),
      done && h("pre", { tabindex: "0" }, job.text),
      h("div", { class: "buttons" },
        job.state === "running" && action("Cancel", () => call("cancel", job.number)),
        done && job.files.includes("report.html") && h("button", { type: "button", class: "primary", onclick: () => read(job) }, "Read the report"),
        done && job.files.includes("model_patch.yaml") && action("Load the patch", async () => { await call("LoadPatch", await call("keep", job.number)); await load(); }, { disabled: !may(context, "LoadPatch") })),
    );
  }

  slow();
  const stopSlow = live.onSlow(slow);
  const element = h(
    "div",
    { class: "diagnosis" },
    h("div", { class: "column" },
      h("section", { class: "panel", "aria-label": "Logs" }, h("h2", {}, "Logs"), logs),
      h("section", { class: "panel", "aria-label": "Diagnoses" }, h("h2", {}, "Diagnoses"), jobs),
      h("section", { class: "panel", "aria-label": "Patch" }, h("h2", {}, "Model patch"), patch, patches, action("Remove the patch", () => call("RemovePatch"), { disabled: !may(context, "RemovePatch") })),
      h("section", { class: "panel", "aria-label": "Gap" }, h("h2", {}, "Measured minus simulated"), gaps)),
    h("section", { class: "panel report", "aria-label": "Report" }, empty, frame),
  );
  return { element, close: stopSlow };
}

/** Channel, course of the last minute, gap now: so one sees it fall when a patch is loaded. */
function gapRow(name: string, gap: number, unit: string): HTMLElement {
  const course = [...(courses.get(name) ?? []), gap].slice(-COURSE);
  courses.set(name, course);
  const most = Math.max(...course.map(Math.abs), 1e-12);
  const points = course.map((value, i) => `${COURSE - course.length + i},${(22 - (20 * Math.abs(value)) / most).toFixed(1)}`).join(" ");
  const line = svg("svg", { viewBox: `0 0 ${COURSE} 24`, class: "course", "aria-hidden": "true" }, svg("polyline", { points }));
  return h("div", { "data-gap": name }, h("dt", {}, name), line, h("dd", {}, `${number(gap)} ${unit}`));
}
