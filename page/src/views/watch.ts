/** Watch: signals as live plots, the time slices, the peers. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { Context, View } from "../context";
import { get, live, type Figures, type Slice } from "../net";
import { grewLately, OVERRUNS } from "../overruns";
import { bytes, h, micros, number, seconds, setText, signalName, toast } from "../ui";

const LONGEST_S = 120;
const HOLE_S = 1;
const COLOURS = ["#0b6bcb", "#d9480f", "#2b8a3e", "#9c36b5", "#b08900", "#0c8599"];
const MOST_LINES = 6;

const START: string[][] = [
  ["wheel.fl.setpoint_rpm", "wheel.fl.speed_rpm"],
  ["velocity.linear_m_s", "velocity.angular_rad_s"],
];
let kept: string[][] | null = null;
let windowS = 20;

/** What was seen of a signal, oldest first; shared by all plots. */
class History {
  readonly times: number[] = [];
  readonly series = new Map<string, (number | null)[]>();

  add(t: number): void {
    if (this.times.length && t < this.times[this.times.length - 1]!) this.clear();
    const last = this.times[this.times.length - 1];
    if (last === t) return;
    if (last !== undefined && t - last > HOLE_S * Math.max(1, live.slow.board.speed ?? 1)) {
      this.times.push((last + t) / 2); // nothing was seen: no line is drawn there
      for (const values of this.series.values()) values.push(null);
    }
    this.times.push(t);
    for (const [name, values] of this.series) {
      const value = live.value(name);
      values.push(Number.isFinite(value) ? value : null);
    }
    const old = this.times.findIndex((time) => time >= t - LONGEST_S);
    if (old > 300) {
      this.times.splice(0, old);
      for (const values of this.series.values()) values.splice(0, old);
    }
  }

  follow(name: string): void {
    if (!this.series.has(name)) this.series.set(name, this.times.map(() => null));
  }

  /** Take in what the ring held: older times in front, and what a new signal was meanwhile. */
  merge(times: number[], series: Record<string, (number | null)[]>): void {
    const first = this.times[0] ?? Infinity;
    const older = times.filter((t) => t < first);
    if (older.length && first - older[older.length - 1]! > HOLE_S) return;
    for (const [name, values] of this.series) {
      const past = series[name];
      let at = 0;
      for (let i = 0; past && i < values.length && times.length; i++) {
        while (at + 1 < times.length && times[at + 1]! <= this.times[i]!) at++;
        if (values[i] === null && this.times[i]! <= times[times.length - 1]!) values[i] = past[at] ?? null;
      }
      values.unshift(...older.map((_, i) => past?.[i] ?? null));
    }
    this.times.unshift(...older);
  }

  clear(): void {
    this.times.length = 0;
    for (const values of this.series.values()) values.length = 0;
  }
}

export function watchView(context: Context): View {
  const history = new History();
  const groups: string[][] = (kept ??= START.map((group) => [...group]));
  const plots: Plot[] = [];
  let paused = false;
  let plotsDue = 0;
  const units = new Map(context.signals.map((signal) => [signal.name, signal.unit]));

  class Plot {
    readonly element: HTMLElement;
    private holder = h("div", { class: "canvas" });
    private chart: uPlot | null = null;
    private observer = new ResizeObserver(() => this.resize());

    constructor(readonly names: string[]) {
      this.element = h("section", { class: "panel plot", "aria-label": "Plot" }, h("div", { class: "plot-head" }), this.holder);
      this.element.addEventListener("dragover", (event) => {
        event.preventDefault();
        this.element.classList.add("target");
      });
      this.element.addEventListener("dragleave", () => this.element.classList.remove("target"));
      this.element.addEventListener("drop", (event) => {
        event.preventDefault();
        event.stopPropagation();
        this.element.classList.remove("target");
        const name = event.dataTransfer?.getData("text/plain") ?? "";
        if (units.has(name)) this.add(name);
      });
      this.observer.observe(this.holder);
      this.build();
    }

    add(name: string): void {
      if (this.names.includes(name)) return;
      if (this.names.length >= MOST_LINES) return void toast(`A plot has at most ${MOST_LINES} lines.`);
      this.names.push(name);
      subscribe();
      this.build();
    }

    private remove(name: string): void {
      this.names.splice(this.names.indexOf(name), 1);
      if (!this.names.length) return drop(this);
      subscribe();
      this.build();
    }

    build(): void {
      this.chart?.destroy();
      const style = getComputedStyle(document.documentElement);
      const ink = style.getPropertyValue("--muted").trim();
      const grid = { stroke: style.getPropertyValue("--line").trim(), width: 1 };
      const axis = { stroke: ink, grid, ticks: grid, font: "11px system-ui", labelFont: "11px system-ui" };
      this.element.firstElementChild!.replaceChildren(
        ...this.names.map((name, i) =>
          h("span", { class: "legend" }, this.swatch(i), signalName(name), h("b", { "data-name": name }, "–"), h("i", {}, units.get(name) ?? ""),
            h("button", { type: "button", class: "x", "aria-label": `Remove ${name}`, onclick: () => this.remove(name) }, "×")),
        ),
      );
      this.names.forEach((name) => history.follow(name));
      this.chart = new uPlot(
        {
          width: Math.max(this.holder.clientWidth, 200),
          height: 190,
          legend: { show: false },
          cursor: { drag: { x: true, y: false }, sync: { key: "watch" } },
          scales: { x: { time: false } },
          axes: [{ ...axis, values: (_, ticks) => ticks.map((t) => `${t} s`) }, { ...axis, size: 48 }],
          series: [{}, ...this.names.map((_, i) => ({ stroke: COLOURS[i], width: 1.6, points: { show: false }, spanGaps: false }))],
          hooks: { setCursor: [() => this.readings()] },
        },
        this.data(),
        this.holder,
      );
    }

    private swatch(i: number): HTMLElement {
      const dot = h("span", { class: "swatch", "aria-hidden": "true" });
      dot.style.background = COLOURS[i]!;
      return dot;
    }

    private data(): uPlot.AlignedData {
      return [history.times, ...this.names.map((name) => history.series.get(name)!)] as uPlot.AlignedData;
    }

    draw(): void {
      if (!this.chart) return;
      this.chart.setData(this.data(), false);
      const end = history.times[history.times.length - 1] ?? 0;
      if (!paused) this.chart.setScale("x", { min: end - windowS, max: end });
      this.readings();
    }

    private readings(): void {
      const at = this.chart?.cursor.idx;
      for (const name of this.names) {
        const values = history.series.get(name)!;
        const value = at == null ? values[values.length - 1] : values[at];
        const shown = this.element.querySelector(`b[data-name="${name}"]`);
        if (shown) setText(shown, number(value));
      }
    }

    private resize(): void {
      this.chart?.setSize({ width: Math.max(this.holder.clientWidth, 200), height: 190 });
    }

    close(): void {
      this.observer.disconnect();
      this.chart?.destroy();
    }
  }

  const begun = new Set<string>();
  function subscribe(): void {
    const names = [...new Set(groups.flat())];
    live.want("watch", ["sim.time_s", ...names]);
    const fresh = names.filter((name) => !begun.has(name)).slice(0, 24);
    for (const name of fresh) begun.add(name);
    if (!fresh.length) return;
    const query = fresh.map((name) => `name=${encodeURIComponent(name)}`).join("&");
    get<{ times: number[]; series: Record<string, (number | null)[]> }>(`history?${query}`)
      .then(({ times, series }) => history.merge(times, series))
      .catch(() => {}); // the plot begins with what comes in
  }

  function open(names: string[]): void {
    const plot = new Plot(names);
    plots.push(plot);
    board.insertBefore(plot.element, dropHere);
  }

  function add(name: string): void {
    groups.push([name]);
    subscribe();
    open(groups[groups.length - 1]!);
  }

  function drop(plot: Plot): void {
    const at = plots.indexOf(plot);
    plots.splice(at, 1);
    groups.splice(at, 1);
    plot.close();
    plot.element.remove();
    subscribe();
  }

  // --- choosing signals -------------------------------------------------------------------------

  const search = h("input", { type: "search", placeholder: "Find a signal", "aria-label": "Find a signal" });
  const list = h("ul", { class: "choices", tabindex: "0", "aria-label": "Signals" });
  function choices(): void {
    const text = search.value.toLowerCase();
    list.replaceChildren(
      ...context.signals
        .filter((signal) => signal.name.toLowerCase().includes(text))
        .map((signal) => {
          const button = h("button", { type: "button", draggable: "true", title: signal.description, onclick: () => add(signal.name) }, signalName(signal.name), h("i", {}, signal.unit));
          button.addEventListener("dragstart", (event) => event.dataTransfer?.setData("text/plain", signal.name));
          return h("li", {}, button);
        }),
    );
  }
  search.addEventListener("input", choices);
  choices();

  // --- the bar ----------------------------------------------------------------------------------

  const pause = h("button", { type: "button", "aria-pressed": "false", onclick: () => {
    paused = !paused;
    pause.setAttribute("aria-pressed", String(paused));
    setText(pause, paused ? "Run on" : "Pause");
  } }, "Pause");
  const span = h("select", { "aria-label": "Length of the plots" }, ...[5, 10, 20, 60, 120].map((s) => h("option", { value: s, selected: s === windowS }, `${s} s`)));
  span.addEventListener("change", () => (windowS = Number(span.value)));
  const save = h("button", { type: "button", onclick: exported }, "Export CSV");

  function exported(): void {
    const names = [...new Set(groups.flat())];
    const lines = history.times.map((t, i) => [t, ...names.map((name) => history.series.get(name)?.[i] ?? "")].join(","));
    const blob = new Blob([["t_s", ...names].join(",") + "\n" + lines.join("\n") + "\n"], { type: "text/csv" });
    const link = h("a", { href: URL.createObjectURL(blob), download: "hilserver.csv" });
    link.click();
    window.setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    toast(`${lines.length} rows, ${bytes(blob.size)}`);
  }

  const dropHere = h("div", { class: "drop" }, "Drop a signal here, or choose one from the list, for a new plot");
  const board = h("div", { class: "plots" }, dropHere);
  board.addEventListener("dragover", (event) => event.preventDefault());
  board.addEventListener("drop", (event) => {
    event.preventDefault();
    const name = event.dataTransfer?.getData("text/plain") ?? "";
    if (units.has(name)) add(name);
  });

  // --- slices and peers -------------------------------------------------------------------------

  const slices = h("div", { class: "cards" });
  const peers = h("div", { class: "cards" });

  function showSlices(): void {
    const { board: told } = live.slow;
    slices.replaceChildren(...Object.entries(told.slices ?? {}).map(([name, slice]) => sliceCard(name, slice, told.bounds_us ?? [])));
    const entries = Object.entries(told.peers ?? {});
    peers.replaceChildren(...(entries.length ? entries.map(([name, peer]) => peerCard(name, peer)) : [h("p", { class: "note" }, "No peers are configured.")]));
  }

  groups.forEach((group) => open(group));
  subscribe();
  showSlices();
  const stopFrames = live.onFrame(() => {
    const t = live.value("sim.time_s");
    if (!paused && Number.isFinite(t)) history.add(t);
    if (!paused && !plotsDue) {
      plotsDue = requestAnimationFrame(() => {
        plotsDue = 0;
        for (const plot of plots) plot.draw();
      });
    }
  });
  const stopSlow = live.onSlow(showSlices);
  const retheme = (): void => plots.forEach((plot) => plot.build());
  window.addEventListener("themechange", retheme);

  const element = h(
    "div",
    { class: "watch" },
    h("aside", { class: "panel chooser", "aria-label": "Choose signals" }, search, list),
    h("div", { class: "column" }, h("div", { class: "tools" }, pause, span, save, h("span", { class: "hint" }, "Drag in a plot to zoom, double-click to see all.")), board,
      h("h2", {}, "Time slices"), slices, h("h2", {}, "Peers"), peers),
  );
  return {
    element,
    close() {
      stopFrames();
      stopSlow();
      cancelAnimationFrame(plotsDue);
      window.removeEventListener("themechange", retheme);
      plots.forEach((plot) => plot.close());
      live.want("watch", []);
    },
  };
}

function rows(pairs: [string, string, boolean?][]): HTMLElement {
  return h("dl", { class: "pairs" }, ...pairs.map(([name, value, warn]) => h("div", { class: warn ? "warn" : "" }, h("dt", {}, name), h("dd", {}, value))));
}

function figure(value: unknown): number | null {
  return typeof value === "number" ? value : null;
}

function sliceCard(name: string, slice: Slice, bounds: number[]): HTMLElement {
  const us = (key: string): string => micros(figure(slice[key]));
  const count = (key: (typeof OVERRUNS)[number]): [string, string, boolean] => {
    const value = Number(slice[key] ?? 0);
    return [key.replace("_", " "), String(value), grewLately(`${name} ${key}`, value)];
  };
  return h(
    "section",
    { class: "panel card", "aria-label": `Slice ${name}` },
    h("h3", {}, name, h("small", {}, `every ${slice.period_ms} ms`)),
    rows([
      ["execution, mean", us("execution_mean_us")],
      ["execution, max", us("execution_max_us")],
      ["margin, last", us("margin_last_us")],
      ["margin, least", us("margin_min_us")],
      ["wake latency, max", us("latency_max_us")],
      ["jitter", us("jitter_us")],
      ...OVERRUNS.map(count),
    ]),
    histogram(slice.latency_counts ?? [], bounds),
  );
}

/** Wake latencies on a logarithmic axis: heights are logarithms too, so that one count shows. */
function histogram(counts: number[], bounds: number[]): HTMLElement {
  const most = Math.log1p(Math.max(1, ...counts));
  const bars = counts.map((count, i) => {
    const bar = h("span", { title: `up to ${i < bounds.length ? micros(bounds[i]) : "more"}: ${count}` });
    bar.style.height = `${(100 * Math.log1p(count)) / most}%`;
    return bar;
  });
  return h("figure", { class: "histogram" }, h("div", { role: "img", "aria-label": "Histogram of the wake latency" }, ...bars), h("figcaption", {}, h("span", {}, "1 µs"), h("span", {}, "wake latency"), h("span", {}, "10 s")));
}

function peerCard(name: string, peer: Figures): HTMLElement {
  const ms = (key: string): string => (typeof peer[key] === "number" ? `${number(peer[key] as number)} ms` : "–");
  const age = peer["input_age_s"];
  return h(
    "section",
    { class: "panel card", "aria-label": `Peer ${name}` },
    h("h3", {}, name, h("small", { class: peer["connected"] ? "ok" : "warn" }, String(peer["state"] ?? "unknown"))),
    rows([
      ["mode", String(peer["mode"] ?? "–")],
      ["age of input", typeof age === "number" ? seconds(age) : "–", peer["stale"] === true],
      ["round trip", ms("round_trip_ms")],
      ["one way", ms("one_way_ms")],
      ["interval", ms("interval_ms")],
      ["reconnects", String(peer["reconnects"] ?? 0)],
      ["last fault", String(peer["faults"] || peer["last_error"] || "none")],
    ]),
  );
}
