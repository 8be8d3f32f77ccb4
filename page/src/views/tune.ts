/** Tune: parameters as sliders while the wheels turn, and how one wheel answers. */

import { may, WHEELS, type Context, type View } from "../context";
import { call, get, live } from "../net";
import { action, field, h, number, setText, svg, toast } from "../ui";

interface Parameter {
  name: string;
  unit: string;
  low: number;
  high: number;
  /** What the configuration has; null as there. */
  configured: number | null;
  value: number | null;
  nullable: boolean;
  /** 0 or 1, and nothing else. */
  flag: boolean;
  /** Values that have a name; null as in the configuration. */
  names: Record<string, number | null>;
  fixed: boolean;
  meaning: string;
}

/** Groups of sliders, by the beginning of the names; the first is shown at first. */
const GROUPS: [string, string[]][] = [
  ["Controller", ["plant.controller."]],
  ["Geometry", ["plant.wheel_radius_m", "plant.wheelbase_m", "plant.track_m", "plant.icr_offset_m", "plant.max_rpm", "plant.exclusive_twist", "kinematics."]],
  ["Process", ["plant.process."]],
  ["Terms", ["terms."]],
  ["Sensors", ["sensors."]],
  ["Own blocks", ["blocks."]],
];
const SHOWN_S = 5;
const CURVES = [["demand_rpm", "demand", "rpm"], ["speed_rpm", "speed", "rpm"], ["duty_pct", "duty", "%"]] as const;
const HEAD = ["Parameter", "Unit", "", "Value", "Configured"];
const POLL_MS = 1000;

/** Ends of a slider: as far as one tunes by hand; the number beside it takes the whole range. */
function ends(p: Parameter): [number, number] {
  const start = p.configured ?? 0;
  const reach = start === 0 ? Math.min(1, Math.max(p.high, -p.low)) : 2 * Math.abs(start);
  return [Math.max(p.low, start - reach), Math.min(p.high, start + reach)];
}

/** Names above the columns; each control says its own to who does not see them. */
function head(): HTMLElement {
  const [first, unit, slider, ...rest] = HEAD.map((text) => h("span", {}, text));
  return h("li", { class: "parameter head", "aria-hidden": "true" }, h("div", {}, first, unit, slider), ...rest);
}

export function tuneView(context: Context): View {
  const allowed = may(context, "ResetParameters");
  const rows = new Map<string, { show: (p: Parameter) => void }>();
  const undone: [string, number | null][] = [];
  const changed = h("p", { class: "hint", role: "status" });
  const undo = action("Undo", async () => {
    const last = undone.pop();
    if (last) await call("set", { [last[0]]: last[1] });
    await load();
  }, { "aria-keyshortcuts": "Control+Z" });
  const reset = action("Reset all", async () => {
    await call("ResetParameters");
    undone.length = 0;
    await load();
  }, { disabled: !allowed });
  const name = h("input", { value: "tuned", pattern: "[A-Za-z0-9_][A-Za-z0-9_.\\-]*", "aria-label": "Name of the patch" });
  const save = action("Save as patch", async () => {
    await call("SaveParameters", name.value);
    toast(`Saved as ${name.value}: load it in the Diagnosis view.`);
  }, { disabled: !may(context, "SaveParameters") });

  async function change(p: Parameter, value: number | null): Promise<void> {
    const before = p.value;
    try {
      await call("set", { [p.name]: value });
      undone.push([p.name, before]);
    } catch (error) {
      toast((error as Error).message, "error");
    }
    await load();
  }

  function row(first: Parameter): HTMLElement {
    let p = first;
    const [low, high] = ends(p);
    const short = p.name.replace(/^(plant\.controller|plant\.process|plant|terms|sensors|kinematics|blocks)\./, "");
    const attributes = { disabled: !allowed || p.fixed, step: "any" };
    const slider = h("input", { type: "range", min: low, max: high, ...attributes, step: p.flag ? 1 : (high - low) / 200, "aria-label": p.name });
    const exact = h("input", { type: "number", min: p.low, max: p.high, ...attributes, "aria-label": `${p.name}, exactly`, placeholder: "null" });
    const back = h("button", { type: "button", class: "quiet", disabled: !allowed || p.fixed, title: "As configured" }, number(p.configured));
    slider.addEventListener("change", () => void change(p, Number(Number(slider.value).toPrecision(4))));
    exact.addEventListener("change", () => void change(p, exact.value === "" ? null : Number(exact.value)));
    back.addEventListener("click", () => void change(p, p.configured));
    const words = Object.entries(p.names);
    const byName = h("select", { "aria-label": `${p.name}, by name`, disabled: attributes.disabled, hidden: !words.length },
      h("option", { value: "" }, "by name"), ...words.map(([word]) => h("option", {}, word)));
    byName.addEventListener("change", () => void change(p, p.names[byName.value] ?? null));
    const element = h("li", { class: "parameter", title: p.meaning },
      h("label", {}, h("b", {}, short), h("small", {}, p.unit), slider, byName), exact, back);
    rows.set(p.name, {
      show(now) {
        p = now;
        element.classList.toggle("changed", now.value !== now.configured);
        if (document.activeElement !== slider) slider.value = String(now.value ?? now.configured ?? 0);
        byName.value = words.find(([, value]) => value === now.value)?.[0] ?? "";
        if (document.activeElement !== exact) exact.value = now.value === null ? "" : String(now.value);
      },
    });
    return element;
  }

  const group = h("select", { "aria-label": "Group of parameters" });
  const lists = h("section", { class: "panel", "aria-label": "Parameters" }, field("Group", group));
  group.addEventListener("change", () => {
    for (const list of lists.querySelectorAll<HTMLElement>("ul")) list.hidden = list.dataset.group !== group.value;
  });
  async function load(): Promise<void> {
    const { parameters } = await get<{ parameters: Parameter[] }>("parameters");
    if (!rows.size) {
      for (const [title, begins] of GROUPS) {
        const own = parameters.filter((p) => begins.some((begin) => p.name.startsWith(begin)));
        if (!own.length) continue;
        lists.append(h("ul", { class: "list parameters", "data-group": title, hidden: group.childElementCount > 0 }, head(), ...own.map(row)));
        group.append(h("option", {}, title));
      }
    }
    for (const p of parameters) rows.get(p.name)?.show(p);
    const n = parameters.filter((p) => p.value !== p.configured).length;
    setText(changed, n === 0 ? "As configured." : `${n} ${n === 1 ? "differs" : "differ"} from the configuration.`);
    undo.disabled = !undone.length;
    save.disabled = n === 0 || !may(context, "SaveParameters");
  }
  const poll = window.setInterval(() => void load().catch(() => undefined), POLL_MS);
  load().catch((error: Error) => toast(error.message, "error"));

  // --- how one wheel answers --------------------------------------------------------------------

  const wheel = h("select", { "aria-label": "Wheel" }, ...WHEELS.map((each) => h("option", { value: each }, each)));
  const lines = CURVES.map(([curve]) => svg("path", { class: `curve ${curve}`, fill: "none" }));
  const chart = svg("svg", { viewBox: "0 0 500 200", preserveAspectRatio: "none", class: "response", role: "img", "aria-label": "Set-point, speed and duty of one wheel" },
    svg("line", { x1: 0, x2: 500, y1: 100, y2: 100, class: "zero" }), ...lines);
  const values = CURVES.map(() => h("b", {}, "–"));
  const keys = CURVES.map(([curve, word, unit], i) =>
    h("span", { class: "legend" }, svg("svg", { viewBox: "0 0 24 4", class: "key", "aria-hidden": "true" }, svg("line", { x1: 0, x2: 24, y1: 2, y2: 2, class: `curve ${curve}` })) as unknown as HTMLElement, word, values[i], unit));
  const height = h("p", { class: "hint" });
  let samples: [number, (number | null)[]][] = [];
  const signal = (curve: string): string => `wheel.${wheel.value}.${curve}`;
  function watch(): void {
    samples = [];
    const names = CURVES.map(([curve]) => signal(curve));
    live.want("tune", ["sim.time_s", ...names]);
    get<{ times: number[]; series: Record<string, (number | null)[]> }>(`history?${names.map((name) => `name=${name}`).join("&")}`)
      .then(({ times, series }) => {
        const last = times[times.length - 1] ?? -Infinity;
        const older = times.map((t, i): [number, (number | null)[]] => [t, names.map((name) => series[name]?.[i] ?? null)]);
        if (names[0] === signal(CURVES[0][0])) samples = [...older, ...samples.filter(([t]) => t > last)];
      })
      .catch(() => {}); // it begins with what comes in
  }
  wheel.addEventListener("change", watch);
  watch();
  const stopFrames = live.onFrame(() => {
    const t = live.value("sim.time_s");
    if (!Number.isFinite(t)) return;
    if (samples.length && t < samples[samples.length - 1]![0]) samples = [];
    samples.push([t, CURVES.map(([curve]) => live.value(signal(curve)))]);
    samples = samples.filter(([then]) => then > t - SHOWN_S);
    const known = (value: number | null | undefined): value is number => Number.isFinite(value);
    const largest = Math.max(10, ...samples.flatMap(([, row]) => row.filter(known).map(Math.abs)));
    for (const [index, line] of lines.entries()) {
      let pen = "M"; // lifted where there is no value
      line.setAttribute("d", samples.map(([then, row]) => {
        const value = row[index];
        if (!known(value)) return (pen = "M"), "";
        const point = `${pen}${(500 * (1 + (then - t) / SHOWN_S)).toFixed(1)},${(100 - (95 * value) / largest).toFixed(1)}`;
        pen = "L";
        return point;
      }).join(""));
      setText(values[index]!, number(samples[samples.length - 1]![1][index]));
    }
    setText(height, `The last ${SHOWN_S} s; top and bottom are ±${number(largest)} rpm or %, zero is in the middle.`);
  });
  function undoByKey(event: KeyboardEvent): void {
    if (event.ctrlKey && event.key === "z" && !(event.target instanceof HTMLInputElement && event.target.type === "number")) undo.click();
  }
  window.addEventListener("keydown", undoByKey);

  const element = h("div", { class: "time tune" }, lists,
    h("div", { class: "column" },
      h("section", { class: "panel", "aria-label": "Response" }, h("h2", {}, "Response"), field("Wheel", wheel), h("div", { class: "plot-head" }, ...keys), chart as unknown as HTMLElement, height),
      h("section", { class: "panel", "aria-label": "Changes" }, h("h2", {}, "Changes"), changed, h("div", { class: "buttons" }, undo, reset),
        h("div", { class: "buttons" }, field("Name", name), save))));
  return {
    element,
    close() {
      window.clearInterval(poll);
      window.removeEventListener("keydown", undoByKey);
      stopFrames();
      live.want("tune", []);
    },
  };
}
