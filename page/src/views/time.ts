/** Time: pause, step, reset, speed, snapshots, recording, and what has happened. */

import { may, type Context, type View } from "../context";
import { considerate } from "../driver";
import { call, get, live, type Happening } from "../net";
import { plotted } from "../plotted";
import { action, ask, bytes, download, field, h, micros, setText, stamp, timeOfDay, toast } from "../ui";

interface File {
  name: string;
  bytes: number;
  modified_s: number;
}

/** Commands and states first; of overruns one line for each slice, below. */
const GROUPS: Record<string, string[]> = {
  "Commands and states": ["state", "safe_state", "setpoint_refused"],
  Peers: ["peer_lost", "peer_restored", "peer_fault"],
  "Model gap": ["model_gap"],
  Overruns: ["overrun"],
};
/** Least severities, as OPC UA counts them. */
const SEVERITIES: Record<string, number> = { "every severity": 0, "warnings and above": 300, "errors only": 700 };
const hiddenGroups = new Set<string>();

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];

export function timeView(context: Context): View {
  const clock = h("output", { class: "clock", "aria-label": "Simulated time" }, "0.000 s");
  const tick = h("span", { class: "hint" });
  const pace = h("dl", { class: "pairs" });
  const run = action("Pause", () => considerate(paused() ? "Resume" : "Pause", () => call(paused() ? "Start" : "Pause")), { class: "primary large" });
  const steps = h("input", { type: "number", min: 1, max: 1000000, value: 100, "aria-label": "Ticks to step" });
  const step = action("Step", () => considerate("Step", () => call("Step", Number(steps.value))), {});
  const reset = action("Reset", () => call("Reset"), {});
  const resetNumbers = action("Reset timing figures", () => call("ResetStatistics"), { class: "quiet" });
  const speeds = h("div", { class: "segments", role: "group", "aria-label": "Speed" });
  for (const speed of SPEEDS) speeds.append(action(`${speed}×`, () => considerate("Change the speed", () => call("SetSpeed", speed)), { "data-speed": speed }));

  function paused(): boolean {
    return live.slow.board.state === "paused";
  }

  // --- snapshots and recording ------------------------------------------------------------------

  const snapshots = h("ul", { class: "list" });
  let saved: string[] = [];
  const name = h("input", { value: "snapshot-1", pattern: "[A-Za-z0-9_][A-Za-z0-9_.\\-]*", "aria-label": "Name of the snapshot" });
  const save = action("Save", async () => {
    await load(); // somebody else may have saved one meanwhile
    const isThere = saved.includes(name.value);
    if (isThere && !(await ask(`There is a snapshot ${name.value}.`, "Replace it? The state that it holds is lost.", "Replace"))) return;
    await call("SaveSnapshot", name.value);
    await load();
    name.value = free(name.value);
  }, { disabled: !may(context, "SaveSnapshot") });
  const recordings = h("ul", { class: "list" });
  const file = h("input", { value: `run-${stamp()}.mcap`, "aria-label": "Name of the recording" });
  const record = action("Record", async () => {
    const isEnd = !!live.slow.board.recording;
    await call(isEnd ? "StopRecording" : "StartRecording", ...(isEnd ? [] : [file.value]));
    if (isEnd) file.value = `run-${stamp()}.mcap`;
    await load();
  }, { disabled: !may(context, "StartRecording") });
  const recording = h("p", { class: "hint", role: "status" });

  /** The next name of that kind that no snapshot has. */
  function free(taken: string): string {
    let next = taken;
    while (saved.includes(next)) next = next.replace(/(\d+)?$/, (digits) => String(Number(digits || 0) + 1));
    return next;
  }

  async function load(): Promise<void> {
    const files = await get<{ snapshots: File[]; logs: File[]; folders: Record<string, string> }>("logs");
    saved = files.snapshots.map((each) => each.name.replace(/\.npz$/, ""));
    snapshots.replaceChildren(...entries(files.snapshots, "No snapshots yet.", (each) =>
      action("Load", () => considerate("Load the snapshot", () => call("LoadSnapshot", each.name)), { disabled: !may(context, "LoadSnapshot"), "aria-label": `Load ${each.name}` })));
    recordings.replaceChildren(...entries(files.logs, "No recordings yet.", (each) => download(each.name)));
  }
  load()
    .then(() => (name.value = free(name.value)))
    .catch((error: Error) => toast(error.message, "error"));

  // --- what has happened ------------------------------------------------------------------------

  const filters = h("div", { class: "segments", role: "group", "aria-label": "Events shown" });
  for (const group of Object.keys(GROUPS)) {
    const button = h("button", { type: "button", "data-group": group, "aria-pressed": String(!hiddenGroups.has(group)) }, group);
    button.addEventListener("click", () => {
      if (!hiddenGroups.delete(group)) hiddenGroups.add(group);
      button.setAttribute("aria-pressed", String(!hiddenGroups.has(group)));
      slow();
    });
    filters.append(button);
  }
  const search = h("input", { type: "search", placeholder: "Find an event", "aria-label": "Find an event" });
  const least = h("select", { "aria-label": "Severity" }, ...Object.entries(SEVERITIES).map(([name, value]) => h("option", { value }, name)));
  for (const control of [search, least]) control.addEventListener("input", slow);
  const events = h("ol", { class: "events", tabindex: "0", "aria-label": "Events, newest first" });

  function slow(): void {
    const { board } = live.slow;
    setText(run, paused() ? "Resume" : "Pause");
    run.disabled = !may(context, "Pause") || board.state === "safe";
    step.disabled = !may(context, "Step") || !paused();
    reset.disabled = !may(context, "Reset");
    for (const button of speeds.children) {
      button.setAttribute("aria-pressed", String(Number((button as HTMLElement).dataset.speed) === board.speed));
      (button as HTMLButtonElement).disabled = !may(context, "SetSpeed");
    }
    const plant = board.slices?.["plant"];
    const us = (key: string): string => micros(plant?.[key] as number | null | undefined);
    const figures = {
      "Real-time factor": board.realtime_factor == null ? "–" : `${board.realtime_factor.toFixed(3)}×`,
      "Step period": plant ? `${plant.period_ms} ms` : "–",
      "Step time, mean": us("execution_mean_us"),
      "Step time, max": us("execution_max_us"),
      "Margin, smallest": us("margin_min_us"),
    };
    pace.replaceChildren(...Object.entries(figures).map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));
    setText(record, board.recording ? "Stop" : "Record");
    setText(recording, board.recording ? `${board.recording.name}: ${bytes(board.recording.bytes)}` : "Nothing is being recorded.");
    const order = Object.keys(GROUPS);
    const known = (board.events ?? []).map((event) => ({ ...event, group: order.find((name) => GROUPS[name]!.includes(event.kind)) ?? order[0]! }));
    for (const button of filters.children as HTMLCollectionOf<HTMLElement>) {
      const count = known.reduce((sum, event) => sum + (event.group === button.dataset.group ? event.count : 0), 0);
      setText(button, `${button.dataset.group} ${count}`);
    }
    const words = search.value.toLowerCase();
    const shown = known.filter((event) => !hiddenGroups.has(event.group) && event.severity >= Number(least.value) && `${event.source} ${event.text}`.toLowerCase().includes(words));
    const rest = (group: string): number => (group === "Overruns" ? 1 : 0); // one line each, below what was done
    shown.sort((one, other) => rest(one.group) - rest(other.group) || one.age_s - other.age_s);
    const kept = new Map(shown.map((event) => {
      const key = event.kind === "overrun" ? event.source : `${event.monotonic_s} ${event.source}`;
      return [key, (items.get(key) ?? item()).show(event)] as const; // one that has the focus keeps it
    }));
    items = kept;
    const rows = shown.length ? [...kept.values()].map(({ element }) => element) : [none];
    rows.forEach((row, i) => events.children[i] === row || events.insertBefore(row, events.children[i] ?? null));
    while (events.children.length > rows.length) events.lastElementChild!.remove();
  }
  let items = new Map<string, Item>();
  const none = h("li", { class: "note" }, "No recent events of this kind.");
  slow();
  live.want("time", ["sim.time_s", "sim.tick"]);
  const stopFrames = live.onFrame(() => {
    const t = live.value("sim.time_s");
    setText(clock, Number.isFinite(t) ? `${t.toFixed(3)} s` : "–");
    setText(tick, `tick ${live.tick}`);
  });
  const stopSlow = live.onSlow(slow);

  const element = h(
    "div",
    { class: "time" },
    h("div", { class: "column" },
      h("section", { class: "panel", "aria-label": "Clock" }, clock, tick, pace,
        h("div", { class: "buttons" }, run, reset),
        h("div", { class: "buttons" }, steps, step, h("span", { class: "hint" }, "ticks, while paused")),
        h("h2", {}, "Speed"), speeds, resetNumbers),
      h("section", { class: "panel", "aria-label": "Snapshots" }, h("h2", {}, "Snapshots"), h("div", { class: "buttons" }, field("Name", name), save), snapshots),
      h("section", { class: "panel", "aria-label": "Recording" }, h("h2", {}, "Recording"), recording, h("div", { class: "buttons" }, field("File", file), record), recordings)),
    h("section", { class: "panel happened", "aria-label": "Events" }, h("h2", {}, "Events"), filters, h("div", { class: "tools" }, search, least), events),
  );
  return {
    element,
    close() {
      stopFrames();
      stopSlow();
      live.want("time", []);
    },
  };
}

interface Item {
  element: HTMLElement;
  show(event: Happening): Item;
}

/** A row for an event, on both clocks; pressed, the plots show what was then. */
function item(): Item {
  let event: Happening;
  const clock = h("time", {});
  const simulated = h("small", {});
  const when = h("button", { type: "button", class: "quiet when", title: "Show it in the plots", onclick: () => find(event) }, clock, simulated);
  const source = h("b", {});
  const text = h("span", {});
  const count = h("small", { class: "chip" });
  const made: Item = {
    element: h("li", {}, when, h("span", {}, source, " ", text, count)),
    show(now) {
      event = now;
      const utcMs = live.utcMsOf(now);
      made.element.classList.toggle("severe", now.severity >= 500);
      when.disabled = now.simulated_s === null;
      clock.dateTime = new Date(utcMs).toISOString();
      setText(clock, timeOfDay(utcMs));
      setText(simulated, now.simulated_s === null ? "" : `${now.simulated_s.toFixed(2)} s`);
      setText(source, now.source);
      setText(text, now.text.replace(`${now.source}: `, ""));
      setText(count, now.count > 1 ? `${now.count} times` : "");
      count.hidden = now.count < 2;
      return made;
    },
  };
  return made;
}

function find({ simulated_s: t }: Happening): void {
  const first = plotted.history.times[0];
  if (first === undefined || t! < first) return toast(first === undefined ? "Nothing is plotted." : `The plots begin at ${first.toFixed(1)} s.`);
  plotted.goTo = t;
  location.hash = "watch";
}

function entries(files: File[], none: string, act: (file: File) => HTMLElement | null): HTMLElement[] {
  if (!files.length) return [h("li", { class: "note" }, none)];
  return files.slice(0, 50).map((file) => h("li", {}, h("code", {}, file.name), h("span", { class: "hint" }, bytes(file.bytes)), act(file)));
}
