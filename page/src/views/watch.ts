/** Watch: signals as live plots, the time slices, the peers. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { Context, View } from "../context";
import { fingers } from "../fingers";
import { History } from "../history";
import { get, live, type Signal } from "../net";
import { bytes, h, recall, setText, signalName, store, toast, valueText } from "../ui";
import { peerCard, sliceCard } from "./cards";

const MOST_LINES = 6;

const START: string[][] = [
  ["wheel.fl.demand_rpm", "wheel.fl.speed_rpm"],
  ["velocity.linear_m_s", "velocity.angular_rad_s"],
];
const SPANS_S = [5, 10, 20, 60, 120];
const KEPT = "watch";
/** Types whose values hold until they change: no line slopes from one to the next. */
const STEPS = new Set(["Boolean", "Byte", "UInt32", "Int64"]);

/** The plots as they were when the page was last open in this browser. */
function recalled(known: Map<string, Signal>): { groups: string[][]; windowS: number } {
  const { groups, windowS } = recall<{ groups: string[][]; windowS: number }>(KEPT);
  const sound = Array.isArray(groups) ? groups.map((group) => [group].flat().filter((name) => known.has(name)).slice(0, MOST_LINES)) : START;
  return { groups: sound.filter((group) => group.length).map((group) => [...group]), windowS: SPANS_S.includes(windowS!) ? windowS! : 20 };
}

export function watchView(context: Context): View {
  const history = new History();
  const known = new Map(context.signals.map((signal) => [signal.name, signal]));
  let { groups, windowS } = recalled(known);
  const plots: Plot[] = [];
  let paused = false;
  let plotsDue = 0;
  let at: number | null = null; // where the cursor stands while the plots are paused

  class Plot {
    readonly element: HTMLElement;
    private holder = h("div", { class: "canvas" });
    private chart: uPlot | null = null;
    private observer = new ResizeObserver(() => this.resize());

    constructor(readonly names: string[]) {
      this.element = h("section", { class: "panel plot" }, h("div", { class: "plot-head" }), this.holder);
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
        if (known.has(name)) this.add(name);
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
      const colours = style.getPropertyValue("--lines").trim().split(" ");
      const grid = { stroke: style.getPropertyValue("--line").trim(), width: 1 };
      const axis = { stroke: ink, grid, ticks: grid, font: "11px system-ui", labelFont: "11px system-ui" };
      this.element.firstElementChild!.replaceChildren(
        ...this.names.map((name, i) =>
          h("span", { class: "legend" }, this.swatch(colours[i]!), signalName(name), h("b", { "data-name": name }, "–"), h("i", {}, known.get(name)!.unit),
            h("button", { type: "button", class: "x", "aria-label": `Remove ${name}`, onclick: () => this.remove(name) }, "×")),
        ),
      );
      this.names.forEach((name) => history.follow(name));
      this.chart = new uPlot(
        {
          width: Math.max(this.holder.clientWidth, 200),
          height: 190,
          legend: { show: false },
          cursor: { y: false, drag: { x: true, y: false }, sync: { key: "watch" } },
          scales: { x: { time: false } },
          axes: [{ ...axis, size: 32, values: (_, ticks) => ticks.map((t) => `${t} s`) }, { ...axis, size: 48, ...this.named() }],
          series: [{}, ...this.names.map((name, i) => ({ stroke: colours[i], width: 1.6, points: { show: false }, spanGaps: false, ...(STEPS.has(known.get(name)!.type) && { paths: uPlot.paths.stepped!({ align: 1 }) }) }))],
          hooks: { setCursor: [() => this.follow()], setScale: [() => this.entitle()] },
        },
        this.data(),
        this.holder,
      );
      fingers(this.chart, stand, stretch);
      this.entitle();
    }

    /** The axis of a single signal whose values have names: these. */
    private named(): uPlot.Axis {
      const { labels } = known.get(this.names[0]!)!;
      if (this.names.length > 1 || !labels.length) return {};
      return { size: 72, incrs: [1, 2, 5], values: (_, ticks) => ticks.map((tick) => labels[tick] ?? "") };
    }

    private swatch(colour: string): HTMLElement {
      const dot = h("span", { class: "swatch", "aria-hidden": "true" });
      dot.style.background = colour;
      return dot;
    }

    private data(): uPlot.AlignedData {
      return [history.times, ...this.names.map((name) => history.series.get(name)!)] as uPlot.AlignedData;
    }

    draw(): void {
      if (!this.chart) return;
      this.chart.setData(this.data(), false);
      const end = history.times[history.times.length - 1] ?? 0;
      if (!paused) this.show(end - windowS, end);
      this.entitle();
      this.readings();
    }

    /** Where the mouse is, the cursor is, too: keys go on from there. */
    private follow(): void {
      const place = this.chart?.cursor.idx;
      if (paused && place != null) mark(place);
      this.readings();
    }

    private readings(): void {
      const place = this.chart?.cursor.idx ?? at;
      for (const name of this.names) {
        const values = history.series.get(name)!;
        const value = place === null ? values[values.length - 1] : values[place];
        const shown = this.element.querySelector(`b[data-name="${name}"]`);
        if (shown) setText(shown, valueText(known.get(name)!, value));
      }
    }

    /** Whoever does not see a plot hears what it shows and, while it stands still, from when to when. */
    private entitle(): void {
      const { min, max } = this.chart?.scales["x"] ?? {};
      const time = paused && min != null && max != null ? ` from ${min.toFixed(2)} s to ${max.toFixed(2)} s` : "";
      const title = `Plot of ${this.names.join(", ")}${time}`;
      if (this.element.ariaLabel !== title) this.element.ariaLabel = title;
    }

    show(min: number, max: number): void {
      this.chart?.setScale("x", { min, max });
    }

    /** Show a time, and what was then. */
    seek(t: number): void {
      const { min = 0, max = 0 } = this.chart!.scales["x"]!;
      if (t < min || t > max) this.show(t - (max - min) / 2, t + (max - min) / 2);
      queueMicrotask(() => { // a scale is set by then
        this.chart?.setCursor({ left: this.chart.valToPos(t, "x"), top: 0 });
        this.readings();
      });
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
    store(KEPT, { groups, windowS });
    const fresh = names.filter((name) => !begun.has(name)).slice(0, 24);
    for (const name of fresh) begun.add(name);
    if (!fresh.length) return;
    const query = fresh.map((name) => `name=${encodeURIComponent(name)}`).join("&");
    get<{ times: number[]; series: Record<string, (number | null)[]> }>(`history?${query}`)
      .then(({ times, series }) => {
        const then = history.times[at ?? -1];
        history.merge(times, series);
        if (paused) stand(then);
      })
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

  const pause = h("button", { type: "button", "aria-pressed": "false", onclick: () => (paused ? go() : stand()) }, "Pause");
  const cursor = h("input", { type: "range", min: 0, class: "cursor", "aria-label": "Cursor", hidden: true });
  const moment = h("output", { class: "moment", hidden: true });
  cursor.addEventListener("input", () => seek(Number(cursor.value)));

  function showPause(): void {
    pause.setAttribute("aria-pressed", String(paused));
    setText(pause, paused ? "Resume" : "Pause");
    cursor.hidden = moment.hidden = !paused;
  }

  function go(): void {
    paused = false;
    at = null;
    showPause();
  }

  /** Let the plots stand; the cursor, which keys and fingers move as well, reaches all that was seen. */
  function stand(t = Infinity): void {
    paused = true;
    showPause();
    const last = Math.max(0, history.times.length - 1);
    const later = history.times.findIndex((time) => time >= t);
    cursor.max = String(last);
    cursor.value = String(later < 0 ? last : later);
    for (const plot of plots) plot.draw();
    seek(Number(cursor.value));
  }

  function mark(place: number): void {
    const t = history.times[place];
    if (t === undefined) return;
    at = place;
    cursor.value = String(place);
    setText(moment, `${t.toFixed(3)} s`);
  }

  function seek(place: number): void {
    mark(place);
    const t = history.times[place];
    if (t !== undefined) for (const plot of plots) plot.seek(t);
  }

  /** Show a stretch of what was seen, in all plots. */
  function stretch(min: number, max: number): void {
    const first = history.times[0] ?? 0;
    const last = history.times[history.times.length - 1] ?? 0;
    const span = Math.min(max - min, last - first);
    const from = Math.max(first, Math.min(min, last - span));
    for (const plot of plots) plot.show(from, from + span);
  }

  const span = h("select", { "aria-label": "Length of the plots" }, ...SPANS_S.map((s) => h("option", { value: s, selected: s === windowS }, `${s} s`)));
  span.addEventListener("change", () => {
    windowS = Number(span.value);
    store(KEPT, { groups, windowS });
    const t = at === null ? undefined : history.times[at];
    if (t !== undefined) stretch(t - windowS / 2, t + windowS / 2);
  });
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
    if (known.has(name)) add(name);
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
    h("div", { class: "column" }, h("div", { class: "tools" }, pause, cursor, moment, span, save, h("span", { class: "hint mouse" }, "Drag in a plot to zoom, double-click to see all."), h("span", { class: "hint touch" }, "Drag a plot with one finger, stretch it with two.")), board,
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
