/** Diagnosis: choose a log or two, follow the work, read the report, load the patch, see the gap. */

import { may, type Context, type View } from "../context";
import { call, get, live, type Job } from "../net";
import { isDiagnosing, send as upload, startedHere } from "../work";
import { compared } from "./compared";
import { proposalCard } from "./proposal";
import { action, ask, bytes, download, field, h, number, setText, svg, toast } from "../ui";

const COURSE = 120; // a minute of boards
const courses = new Map<string, number[]>();

/** A title says what was found; null: the sweep has not ended. */
interface Sweep {
  name: string;
  title: string | null;
}

export function diagnosisView(context: Context): View {
  const logs = h("ul", { class: "list" });
  const jobs = h("ul", { class: "jobs" });
  const patches = h("ul", { class: "list" });
  const sweeps = h("ul", { class: "list sweeps" });
  const patch = h("p", { class: "hint", role: "status" });
  const remove = action("Remove the patch", () => call("RemovePatch"));
  const misfit = h("p", { class: "misfit", role: "alert", hidden: true });
  const mayWork = may(context, "Start");
  let mappings: string[] = [];
  const gaps = h("dl", { class: "pairs" });
  const frame = h("iframe", { sandbox: "", title: "Report" });
  const report = h("section", { class: "panel report", "aria-label": "Report", hidden: true }, frame);
  const units = new Map(context.signals.map((signal) => [signal.name, signal.unit]));

  async function load(): Promise<void> {
    const files = await get<{ logs: { name: string; bytes: number }[]; patches: { name: string }[]; sweeps: Sweep[]; folders: Record<string, string>; mappings: string[] }>("logs");
    mappings = files.mappings;
    logs.replaceChildren(
      ...(files.logs.length
        ? files.logs.map((log) =>
            h("li", {}, h("code", {}, log.name), h("span", { class: "hint" }, bytes(log.bytes)),
              download(log.name),
              action("Diagnose", () => diagnose(log.name), { disabled: !mayWork, "aria-label": `Diagnose ${log.name}` }),
              action("Compare", () => compare(log.name, files.logs.map(({ name }) => name)), { disabled: !mayWork || files.logs.length < 2, "aria-label": `Compare ${log.name}` })))
        : [h("li", { class: "note" }, `No logs yet: record a run, upload a log, or put one in the folder ${files.folders["recordings"]}.`)]),
    );
    patches.replaceChildren(
      ...(files.patches.length
        ? files.patches.map(({ name }) => h("li", {}, h("code", {}, name), action("Load", () => call("LoadPatch", name), { disabled: !may(context, "LoadPatch"), "aria-label": `Load ${name}` })))
        : [h("li", { class: "note" }, `No patches yet: run a diagnosis, or put one in the folder ${files.folders["patches"]}.`)]),
    );
    sweeps.replaceChildren(
      ...(files.sweeps.length ? files.sweeps.map(sweepItem) : [h("li", { class: "note" }, `No sweeps yet: run hilserver sweep FILE -o ${files.folders["sweeps"]}/NAME.`)]),
    );
  }

  async function diagnose(log: string, mapping = ""): Promise<void> {
    const waits = isDiagnosing();
    startedHere(await call<number>("diagnose", log, mapping));
    toast(waits ? `The diagnosis of ${log} waits for its turn.` : `The diagnosis of ${log} has started.`);
  }

  /** Draw a log and another one over each other. */
  async function compare(log: string, all: string[]): Promise<void> {
    const others = all.filter((name) => name !== log);
    const other = h("select", {}, ...others.map((name) => h("option", { value: name }, name)));
    if (!(await ask("Compare two logs", `${log} is A. Which one is B?`, "Compare", field("B", other)))) return;
    const number = await call<number>("compare", log, other.value);
    awaited = number;
    startedHere(number);
  }

  /** A log of others: which of its columns is which signal? */
  async function name(job: Job): Promise<void> {
    const text = h("textarea", { rows: 16, spellcheck: "false" });
    text.value = job.mapping;
    const known = h("select", {}, h("option", { value: "" }, "the mapping below"), ...mappings.map((each) => h("option", { value: each }, `built in: ${each}`)));
    const said = `${job.log} does not use hilserver's signal names. The mapping below is a first guess: check and complete it. It is stored beside the log.`;
    if (!(await ask("Name the columns", said, "Diagnose with it", field("Take", known), field("Mapping", text)))) return;
    if (!known.value) await call("map", job.log, text.value);
    await diagnose(job.log, known.value);
  }

  const picker = h("input", { type: "file", accept: ".csv,.mcap,.parquet,.db3", hidden: true });
  picker.addEventListener("change", () => void send.click());
  const send = action("Upload a log", async () => {
    const file = picker.files?.[0];
    if (!file) return picker.click();
    picker.value = "";
    toast(`${file.name} is being uploaded: ${bytes(file.size)}.`);
    const size = await upload(file);
    toast(`${file.name} is uploaded: ${bytes(size)}.`);
    await load();
  }, { disabled: !mayWork });

  function sweepItem({ name, title }: Sweep): HTMLElement {
    const open = h("button", { type: "button", disabled: title === null, "aria-label": `Read the report of ${name}`, onclick: () => read(`sweeps/${name}`) }, "Read");
    return h("li", {}, h("code", {}, name), h("span", { class: "hint" }, title ?? "not finished"), open);
  }

  function read(folder: string, look = true): void {
    frame.src = `./api/reports/${folder}/report.html`;
    report.hidden = false;
    comparison.element.hidden = true;
    element.classList.add("reading");
    if (look) report.scrollIntoView({ block: "nearest" });
  }

  const comparison = compared();
  async function show(folder: string): Promise<void> {
    await comparison.show(folder);
    report.hidden = true;
    element.classList.add("reading");
    comparison.element.scrollIntoView({ block: "nearest" });
  }

  /** The comparison that this view has started: it is shown as soon as it is done. */
  let awaited: number | null = null;
  let shown = "";
  let listed = "";
  function slow(): void {
    const { jobs: told, board } = live.slow;
    const made = `${board.patch} ${board.recalibration?.proposal?.number}`;
    if (made !== listed) {
      listed = made;
      load().catch((error: Error) => toast(error.message, "error"));
    }
    const text = JSON.stringify(told);
    if (text !== shown || !jobs.children.length) {
      shown = text;
      jobs.replaceChildren(...(told.length ? told.map((job) => jobItem(job)) : [h("li", { class: "note" }, "No diagnosis yet.")]));
      const done = told.find((job) => job.number === awaited && job.state === "done");
      if (done) {
        awaited = null;
        show(done.folder).catch((error: Error) => toast(error.message, "error"));
      }
    }
    misfit.hidden = !board.patch_notice;
    setText(misfit, `${board.patch} ${(board.patch_notice ?? "").replace(/^[^:]*: /, "")}.`);
    setText(patch, board.patch ? `${board.patch} is loaded.` : "No patch is loaded.");
    remove.disabled = !board.patch || !may(context, "RemovePatch");
    const entries = Object.entries(board.gaps ?? {});
    const none = h("div", {}, h("dt", {}, "No measured values are coming in."), h("dd", {}, ""));
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
      job.state === "running" && job.waits && h("span", { class: "hint waits" }, "Waiting for free processor time: this runs at the lowest priority."),
      (job.text || done) && h("pre", { tabindex: "0" }, done && job.kind === "comparison" ? job.text.split("\n\n")[0]! : job.text),
      h("div", { class: "buttons" },
        (job.state === "running" || job.state === "waiting") && action("Cancel", () => call("cancel", job.number)),
        job.mapping && action("Name the columns …", () => name(job), { class: "primary", disabled: !mayWork }),
        done && job.files.includes("report.html") && h("button", { type: "button", class: "primary", onclick: () => read(job.folder) }, "Read the report"),
        done && job.files.includes("comparison.json") && action("Show the comparison", () => show(job.folder), { class: "primary" }),
        done && job.files.includes("model_patch.yaml") && action("Load the patch", async () => { await call("LoadPatch", await call("keep", job.number)); await load(); }, { disabled: !may(context, "LoadPatch") })),
    );
  }

  const card = proposalCard(context);
  card.show(live.slow.board);
  slow();
  const stopCard = live.onSlow(() => card.show(live.slow.board));
  const stopSlow = live.onSlow(slow);
  const element = h(
    "div",
    { class: "diagnosis" },
    h("div", { class: "column" },
      card.element,
      h("section", { class: "panel", "aria-label": "Logs" }, h("h2", {}, "Logs"), logs, picker, send),
      h("section", { class: "panel", "aria-label": "Diagnoses" }, h("h2", {}, "Diagnoses and comparisons"), jobs),
      h("section", { class: "panel", "aria-label": "Patch" }, h("h2", {}, "Model patch"), patch, misfit, patches, remove),
      h("section", { class: "panel", "aria-label": "Sweeps" }, h("h2", {}, "Sweeps"), sweeps),
      h("section", { class: "panel", "aria-label": "Gap" }, h("h2", {}, "Measured minus simulated"), gaps)),
    report,
    comparison.element,
  );
  const newest = live.slow.jobs.find((job) => job.state === "done" && job.files.includes("report.html"));
  if (newest) read(newest.folder, false);
  return { element, close: () => { stopCard(); stopSlow(); comparison.close(); } };
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
