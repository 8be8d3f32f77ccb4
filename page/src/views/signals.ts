/** Signals: every value with unit, quality and age; forces, faults, scenarios. */

import { may, type Context, type FaultForm, type View } from "../context";
import { considerate } from "../driver";
import { call, get, live, type Signal } from "../net";
import { action, copy, field, h, quality, qualityName, seconds, setText, signalName, toast, valueText } from "../ui";

/** Where a number begins that the one who injects has not thought about. */
const DEFAULTS: Record<string, number> = {
  offset: 1, sd: 0.1, factor: 1.1, delay_s: 0.1, jitter_s: 0.05, probability: 0.2, every_s: 0.1, step: 0.1, size: 10, value: 0,
};

interface Row {
  signal: Signal;
  element: HTMLTableRowElement;
  value: HTMLElement;
  quality: HTMLElement;
  age: HTMLElement;
  act: HTMLElement;
  last: number;
  status: number;
  changed: number;
}

/** Which signals are shown, by what they are now. */
const WHICH: Record<string, (row: Row) => boolean> = {
  "all signals": () => true,
  "not good": ({ status }) => status > 0 && quality(status) !== "forced",
  forced: ({ status }) => quality(status) === "forced",
  "changed lately": ({ changed }) => performance.now() - changed < LATELY_MS,
};
const LATELY_MS = 2000;

export function signalsView(context: Context): View {
  const rows: Row[] = context.signals.map((signal) => makeRow(context, signal));
  const body = h("tbody", {}, ...rows.map((row) => row.element));
  const count = h("span", { class: "hint", role: "status" });
  const search = h("input", { type: "search", placeholder: "Find a signal", "aria-label": "Find a signal" });
  search.addEventListener("input", filter);
  const which = h("select", { "aria-label": "Signals shown" }, ...Object.keys(WHICH).map((name) => h("option", {}, name)));
  which.addEventListener("change", filter);
  const copied = action("Copy", async () => {
    const shown = rows.filter((row) => !row.element.hidden);
    await copy(shown.map(({ signal, last, status }) => [signal.name, last, signal.unit, qualityName(status)].join("\t")).join("\n"));
    toast(`${shown.length} values in full precision are on the clipboard.`);
  }, { "aria-label": "Copy the values shown" });

  function filter(): void {
    const words = search.value.toLowerCase().split(/\s+/);
    let n = 0;
    for (const row of rows) {
      const text = `${row.signal.name} ${row.signal.description}`.toLowerCase();
      row.element.hidden = !WHICH[which.value]!(row) || !words.every((word) => text.includes(word));
      if (!row.element.hidden) n += 1;
    }
    setText(count, `${n} of ${rows.length}`);
  }
  filter();

  // --- faults -----------------------------------------------------------------------------------

  const active = h("ul", { class: "list" });
  const kind = h("select", {}, ...context.faults.map(({ name }) => h("option", {}, name)));
  const meaning = h("small", { class: "hint" });
  const peer = h("select", {});
  const on = h("input", { list: "signal-names", value: "imu.gyro_z_rad_s" });
  const parameters = h("div", { class: "parameters" });
  const lasts = h("input", { type: "number", min: 0, step: 0.1, value: 5 });
  const inputs = new Map<string, HTMLInputElement>();

  const place = h("select", {}, h("option", { value: "signal" }, "a signal"), h("option", { value: "peer" }, "a peer's link"));
  const placeField = field("Acts on", place);
  const onField = field("Signal", on);
  onField.classList.add("wide");
  const peerField = field("Peer", peer);
  const form = (): FaultForm => context.faults.find(({ name }) => name === kind.value)!;

  function showKeys(): void {
    const { text, needs, takes, on: places } = form();
    const words = `${text.charAt(0).toUpperCase()}${text.slice(1)}.`.split("`"); // every second one is a key
    meaning.replaceChildren(...words.map((word, i) => (i % 2 ? h("code", {}, word) : word)));
    inputs.clear();
    for (const key of needs) inputs.set(key, h("input", { type: "number", step: "any", value: DEFAULTS[key] }));
    for (const key of takes) inputs.set(key, h("input", { type: "number", step: "any", placeholder: "not set" }));
    parameters.replaceChildren(...[...inputs].map(([key, input]) => field(key, input)));
    placeField.hidden = places.length < 2;
    if (places.length === 1) place.value = places[0]!;
    showPlace();
  }
  function showPlace(): void {
    const none = !form().on.length;
    onField.hidden = none || place.value !== "signal";
    peerField.hidden = none || place.value !== "peer";
    const names = Object.keys(live.slow.board.peers ?? {});
    if (names.join() !== [...peer.options].map(({ value }) => value).join()) peer.replaceChildren(...names.map((name) => h("option", {}, name)));
  }
  kind.addEventListener("change", showKeys);
  place.addEventListener("change", showPlace);
  showKeys();

  async function inject(): Promise<void> {
    const fault: Record<string, unknown> = { fault: kind.value };
    if (form().on.length) fault[place.value] = place.value === "signal" ? on.value : peer.value;
    for (const [key, input] of inputs) if (input.value !== "") fault[key] = Number(input.value);
    if (Number(lasts.value) > 0) fault["for_s"] = Number(lasts.value);
    await call("InjectFault", JSON.stringify(fault));
  }

  // --- scenarios --------------------------------------------------------------------------------

  const scenarios = h("ul", { class: "list" });
  const running = h("p", { class: "hint", role: "status" });
  const end = action("Stop", () => call("StopScenario"), { "aria-label": "Stop the scenario" });
  async function loadScenarios(): Promise<void> {
    const { scenarios: files, folders } = await get<{ scenarios: { name: string }[]; folders: Record<string, string> }>("logs");
    scenarios.replaceChildren(
      ...(files.length
        ? files.map(({ name }) => h("li", {}, h("code", {}, name), action("Start", () => considerate("Start the scenario", () => call("StartScenario", name)), { disabled: !may(context, "StartScenario"), "aria-label": `Start ${name}` })))
        : [h("li", { class: "note" }, `No scenarios yet: put one in the folder ${folders["scenarios"]}.`)]),
    );
  }
  loadScenarios().catch((error: Error) => toast(error.message, "error"));

  let shownFaults = "";
  function slow(): void {
    const { faults = [], scenario } = live.slow.board;
    const text = JSON.stringify(faults);
    if (text !== shownFaults || !active.children.length) {
      shownFaults = text;
      active.replaceChildren(
        ...(faults.length
          ? faults.map((fault) =>
              h("li", { class: fault.acts ? "acts" : "" }, h("code", {}, fault.name), h("span", { class: "hint" }, fault.acts ? "acts" : "waits"),
                fault.fault === "force" && action("Release", () => call("Unforce", fault.place), { "aria-label": `Release ${fault.place}` })),
            )
          : [h("li", { class: "note" }, "No active faults, no forced signals.")]),
      );
    }
    end.disabled = !scenario || !may(context, "StopScenario");
    setText(running, scenario ? `${scenario.name}: ${seconds(scenario.seconds)} of ${seconds(scenario.length_s)}` : "No scenario is playing.");
  }
  slow();

  live.want("signals", context.signals.map((signal) => signal.name));
  let due = 0;
  const stopFrames = live.onFrame(() => {
    const now = performance.now();
    for (const row of rows) {
      const reading = live.get(row.signal.name);
      if (reading && (reading.value !== row.last || reading.status !== row.status)) {
        [row.last, row.status, row.changed] = [reading.value, reading.status, now];
      }
    }
    if (now < due) return; // ten times a second is as fast as one can read
    due = now + 100;
    if (which.value !== "all signals") filter();
    for (const row of rows) if (!row.element.hidden) show(row, now);
  });
  const stopSlow = live.onSlow(slow);

  const element = h(
    "div",
    { class: "signals" },
    h(
      "section",
      { class: "panel table" , "aria-label": "All signals" },
      h("div", { class: "tools" }, search, which, copied, count),
      h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Table of signals" },
        h("table", {}, h("thead", {}, h("tr", {}, ...["Signal", "Value", "Unit", "Quality", "Age", "Force"].map((name) => h("th", { scope: "col" }, name)))), body)),
    ),
    h(
      "div",
      { class: "column" },
      h("section", { class: "panel", "aria-label": "Faults" }, h("h2", {}, "Faults and forces"), active,
        h("div", { class: "form" }, field("Kind", kind), meaning, placeField, onField, peerField, parameters, field("Lasts [s]", lasts, "0: until cleared"),
          h("div", { class: "buttons" }, action("Inject", inject, { class: "primary", disabled: !may(context, "InjectFault") }), action("Clear all", () => call("ClearFaults"), { disabled: !may(context, "ClearFaults") })))),
      h("section", { class: "panel", "aria-label": "Scenarios" }, h("h2", {}, "Scenarios"), running, scenarios, end),
      h("datalist", { id: "signal-names" }, ...context.signals.map((signal) => h("option", { value: signal.name }))),
    ),
  );
  return {
    element,
    close() {
      stopFrames();
      stopSlow();
      live.want("signals", []);
    },
  };
}

function makeRow(context: Context, signal: Signal): Row {
  const value = h("td", { class: "number", "data-unit": signal.unit === "1" ? null : signal.unit }, "–");
  const kind = h("td", {}, h("span", { class: "quality" }, "–"));
  const age = h("td", { class: "number" }, "–");
  const act = h("td", {});
  const row: Row = {
    signal, value, quality: kind.firstElementChild as HTMLElement, age, act,
    element: h("tr", {}, h("th", { scope: "row", title: signal.description }, signalName(signal.name)), value, h("td", { class: "unit" }, signal.unit), kind, age, act),
    last: NaN, status: -1, changed: performance.now(),
  };
  if (may(context, "Force") && !signal.name.startsWith("sim.")) offerForce(row);
  return row;
}

function offerForce(row: Row): void {
  const { name } = row.signal;
  const begin = h("button", { type: "button", class: "quiet", "aria-label": `Force ${name}` }, "Force");
  begin.addEventListener("click", () => {
    const input = h("input", { type: "number", step: "any", value: Number.isFinite(row.last) ? Number(row.last.toPrecision(5)) : 0, "aria-label": `Value for ${name}` });
    const hold = action("Hold", async () => {
      await call("Force", name, Number(input.value));
      back();
    }, { class: "primary" });
    const back = (): void => row.act.replaceChildren(begin);
    input.addEventListener("keydown", (event) => {
      if (event.key === "Enter") hold.click();
      if (event.key === "Escape") back();
    });
    row.act.replaceChildren(h("span", { class: "inline" }, input, hold));
    input.focus();
    input.select();
  });
  row.act.replaceChildren(begin);
  row.element.addEventListener("release", () => row.act.replaceChildren(begin));
}

function show(row: Row, now: number): void {
  const bad = row.status >= 0x80000000;
  setText(row.value, bad || row.status < 0 ? "–" : valueText(row.signal, row.last));
  setText(row.quality, row.status < 0 ? "–" : qualityName(row.status));
  const kind = row.status < 0 ? "bad" : quality(row.status);
  if (row.quality.dataset.quality !== kind) row.quality.dataset.quality = kind;
  setText(row.age, seconds(Math.max(0, now - row.changed) / 1000));
}
