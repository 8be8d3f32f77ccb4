/** One plot: lines over time, or over the first of its signals. */

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { fingers, type Hands } from "../fingers";
import { happenings } from "../happened";
import type { Signal } from "../net";
import { MOST_LINES, plotted } from "../plotted";
import { h, setText, signalName, timeOfDay, toast, valueText } from "../ui";

const HEIGHT = 200;
/** Types whose values hold until they change: no line slopes from one to the next. */
const STEPS = new Set(["Boolean", "Byte", "UInt32", "Int64"]);

/** What all plots of the view have in common. */
export interface Desk extends Hands {
  known: Map<string, Signal>;
  isPaused(): boolean;
  /** Place in the history that is read; null: the newest. */
  place(): number | null;
  /** The stretch of time that is shown [s]. */
  stretch(): [min: number, max: number];
  /** Called with the place under the mouse; null: it has left. */
  hover(place: number | null): void;
  /** A stretch that was marked with the mouse. */
  marked(min: number, max: number): void;
  remove(plot: Plot): void;
}

interface Look {
  ink: string;
  red: string;
  colours: string[];
  axis: uPlot.Axis;
}

/** A colour of the page's present look. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** The colours of lines, in their order. */
export function colours(): string[] {
  return colour("--lines").split(" ");
}

export function axisOf(): uPlot.Axis {
  const grid = { stroke: colour("--line"), width: 1 };
  const font = "11px system-ui";
  return { stroke: colour("--muted"), grid, ticks: grid, font, labelFont: font, labelSize: 16, labelGap: 2 };
}

function look(): Look {
  return { ink: colour("--muted"), red: colour("--red-ink"), colours: colours(), axis: axisOf() };
}

/** A range that shows a value that does not change as a line in the middle, not as noise. */
export function sensible(low: number | null, high: number | null): [number, number] {
  const [min, max] = [low ?? 0, high ?? 0];
  const size = Math.max(Math.abs(min), Math.abs(max));
  if (max - min > Math.max(1e-9, 1e-6 * size)) return uPlot.rangeNum(min, max, 0.1, true) as [number, number];
  const room = size > 1e-9 ? 0.1 * size : 1;
  return [min - room, max + room];
}

/** Two ranges of the same unit with the same length per pixel: a path keeps its shape. */
function alike(range: [number, number], other: [number, number], pixels: number, others: number): [number, number] {
  const span = Math.max(range[1] - range[0], ((other[1] - other[0]) * pixels) / Math.max(others, 1));
  const middle = (range[0] + range[1]) / 2;
  return [middle - span / 2, middle + span / 2];
}

export class Plot {
  readonly element: HTMLElement;
  private holder = h("div", { class: "canvas" });
  private chart: uPlot | null = null;
  private look: Look = look();
  private observer = new ResizeObserver(() => this.chart?.setSize(this.size()));

  constructor(
    readonly names: string[],
    private desk: Desk,
  ) {
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
      if (desk.known.has(name)) this.add(name);
    });
    this.observer.observe(this.holder);
    this.build();
  }

  private add(name: string): void {
    if (this.names.includes(name)) return;
    if (this.names.length >= MOST_LINES) return void toast(`A plot has at most ${MOST_LINES} lines.`);
    this.names.push(name);
    plotted.changed();
    this.build();
  }

  private removeLine(name: string): void {
    this.names.splice(this.names.indexOf(name), 1);
    if (this.names.length < 2) plotted.over.delete(this.names);
    if (!this.names.length) return this.desk.remove(this);
    plotted.changed();
    this.build();
  }

  /** Whether the first signal is the x axis of the others. */
  private get isOver(): boolean {
    return plotted.over.has(this.names);
  }

  private turn(): void {
    if (!plotted.over.delete(this.names)) plotted.over.add(this.names);
    plotted.save();
    this.build();
  }

  private unit(name: string): string {
    return this.desk.known.get(name)!.unit;
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(this.holder.clientWidth, 200), height: HEIGHT };
  }

  build(): void {
    this.chart?.destroy();
    this.look = look();
    const turn = h("button", { type: "button", class: "quiet turn", "aria-pressed": String(this.isOver), title: "The first signal as the x axis of the others", onclick: () => this.turn() }, "x over y");
    this.element.firstElementChild!.replaceChildren(...this.names.map((name, i) => this.legend(name, i)), ...(this.names.length > 1 ? [turn] : []));
    this.chart = this.isOver ? this.overSignal() : this.overTime();
    this.draw();
  }

  private legend(name: string, i: number): HTMLElement {
    const dot = h("span", { class: "swatch", "aria-hidden": "true" });
    const isAxis = this.isOver && i === 0;
    dot.style.background = isAxis ? "transparent" : this.look.colours[i]!;
    const remove = h("button", { type: "button", class: "x", "aria-label": `Remove ${name}`, onclick: () => this.removeLine(name) }, "×");
    return h("span", { class: "legend" }, isAxis ? "x" : dot, signalName(name), h("b", { "data-name": name }, "–"), h("i", {}, this.unit(name)), remove);
  }

  private overTime(): uPlot {
    const { axis, colours } = this.look;
    const units = [...new Set(this.names.map((name) => this.unit(name)))];
    const chart = new uPlot(
      {
        ...this.size(),
        legend: { show: false },
        cursor: { y: false, drag: { x: true, y: false, setScale: false }, sync: { key: "watch" } },
        scales: { x: { time: false }, ...Object.fromEntries(units.map((unit) => [unit, { range: (_: uPlot, low: number, high: number) => sensible(low, high) }])) },
        axes: [
          { ...axis, size: 44, space: 70, values: (_, ticks) => ticks.map((t) => `${Number(t.toFixed(6))} s\n${this.wall(t)}`) },
          ...units.map((unit, i): uPlot.Axis => ({ ...axis, scale: unit, side: i ? 1 : 3, size: 46, label: unit === "1" ? "" : unit, ...(i && { grid: { show: false } }), ...this.named(unit) })),
        ],
        series: [{}, ...this.names.map((name, i): uPlot.Series => ({ scale: this.unit(name), stroke: colours[i], width: 1.6, points: { show: false }, spanGaps: false, ...(STEPS.has(this.desk.known.get(name)!.type) && { paths: uPlot.paths.stepped!({ align: 1 }) }) }))],
        hooks: {
          draw: [(drawn) => this.marks(drawn)],
          setCursor: [(drawn) => drawn.over.matches(":hover") && this.desk.hover(drawn.cursor.idx ?? null)],
          setSelect: [(drawn) => this.select(drawn)],
        },
      },
      this.data(),
      this.holder,
    );
    chart.over.addEventListener("pointerleave", () => this.desk.hover(null));
    chart.over.addEventListener("dblclick", () => this.desk.marked(-Infinity, Infinity));
    fingers(chart, this.desk);
    return chart;
  }

  private wall(t: number): string {
    const ms = plotted.history.utcOf(t);
    return Number.isFinite(ms) ? timeOfDay(ms) : "";
  }

  private select(chart: uPlot): void {
    const { left, width } = chart.select;
    if (width < 1) return;
    const [min, max] = [chart.posToVal(left, "x"), chart.posToVal(left + width, "x")];
    chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.desk.marked(min, max);
  }

  private overSignal(): uPlot {
    const { axis, colours } = this.look;
    const [first, ...others] = this.names as [string, ...string[]];
    const unit = this.unit(others[0]!);
    const isAlike = others.every((name) => this.unit(name) === this.unit(first)) && unit !== "1";
    const of = (names: string[]): [number, number] => {
      const [from, to] = this.places();
      let [low, high] = [Infinity, -Infinity];
      for (const name of names) {
        const values = plotted.history.series.get(name)!;
        for (let i = from; i <= to; i++) {
          const value = values[i];
          if (value == null) continue;
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
      return low > high ? sensible(null, null) : sensible(low, high);
    };
    const range = (names: string[], against: string[], isX: boolean) => (chart: uPlot): [number, number] => {
      const { clientWidth: width, clientHeight: height } = chart.over;
      return isAlike ? alike(of(names), of(against), isX ? width : height, isX ? height : width) : of(names);
    };
    const label = (name: string, of: string): string => (of === "1" ? name : `${name}, ${of}`);
    return new uPlot(
      {
        ...this.size(),
        legend: { show: false },
        cursor: { show: false },
        scales: { x: { time: false, range: range([first], others, true) }, y: { range: range(others, [first], false) } },
        axes: [
          { ...axis, size: 30, label: label(first, this.unit(first)) },
          { ...axis, size: 46, label: others.length > 1 ? unit : label(others[0]!, unit) },
        ],
        series: [{}, { show: true, points: { show: false } }],
        hooks: { draw: [(chart) => others.forEach((name, i) => this.path(chart, first, name, colours[i + 1]!))] },
      },
      [[0, 1], [null, null]],
      this.holder,
    );
  }

  private places(): [number, number] {
    const [min, max] = this.desk.stretch();
    return [plotted.history.placeOf(min), plotted.history.placeOf(max)];
  }

  /** One signal over another, and a dot where the cursor reads. */
  private path(chart: uPlot, first: string, second: string, colour: string): void {
    const { series } = plotted.history;
    const [xs, ys] = [series.get(first)!, series.get(second)!];
    const [from, to] = this.places();
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.beginPath();
    let isDown = false;
    for (let i = from; i <= to; i++) {
      const [x, y] = [xs[i], ys[i]];
      if (x == null || y == null) {
        isDown = false;
        continue;
      }
      const point = [chart.valToPos(x, "x", true), chart.valToPos(y, "y", true)] as const;
      if (isDown) ctx.lineTo(...point);
      else ctx.moveTo(...point);
      isDown = true;
    }
    ctx.strokeStyle = ctx.fillStyle = colour;
    ctx.lineWidth = 1.6 * devicePixelRatio;
    ctx.stroke();
    const at = this.desk.place() ?? plotted.history.times.length - 1;
    const [x, y] = [xs[at], ys[at]];
    if (x != null && y != null) {
      ctx.beginPath();
      ctx.arc(chart.valToPos(x, "x", true), chart.valToPos(y, "y", true), 4 * devicePixelRatio, 0, 2 * Math.PI);
      ctx.fill();
    }
    ctx.restore();
  }

  /** What happened in the stretch that is shown: a dashed line each. */
  private marks(chart: uPlot): void {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
    const { min = 0, max = 0 } = chart.scales["x"]!;
    for (const event of happenings()) {
      const t = event.simulated_s;
      if (t === null || t < min! || t > max!) continue;
      const x = Math.round(chart.valToPos(t, "x", true));
      ctx.strokeStyle = event.severity >= 500 ? this.look.red : this.look.ink;
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  /** The axis of a single signal whose values have names: these. */
  private named(unit: string): uPlot.Axis {
    const { labels } = this.desk.known.get(this.names[0]!)!;
    if (this.names.length > 1 || !labels.length) return unit === "1" ? { label: "", size: 48 } : {};
    return { size: 72, incrs: [1, 2, 5], values: (_, ticks) => ticks.map((tick) => labels[tick] ?? "") };
  }

  private data(): uPlot.AlignedData {
    const { times, series } = plotted.history;
    return [times, ...this.names.map((name) => series.get(name)!)] as uPlot.AlignedData;
  }

  draw(): void {
    if (!this.chart) return;
    if (this.isOver) {
      this.chart.setData([[0, 1], [null, null]]);
    } else {
      const [min, max] = this.desk.stretch();
      this.chart.setData(this.data(), false);
      this.chart.setScale("x", { min, max });
    }
    this.entitle();
    this.readings();
  }

  /** Put the cursor where all plots are read. */
  point(): void {
    const place = this.desk.place();
    if (this.isOver) return this.chart?.redraw(false);
    queueMicrotask(() => { // a scale is set by then
      const t = place === null ? undefined : plotted.history.times[place];
      const left = t === undefined ? -10 : (this.chart?.valToPos(t, "x") ?? -10);
      this.chart?.setCursor({ left, top: 0 }, false);
    });
  }

  readings(): void {
    const { series, times } = plotted.history;
    const place = this.desk.place() ?? times.length - 1;
    for (const name of this.names) {
      const shown = this.element.querySelector(`b[data-name="${name}"]`);
      if (shown) setText(shown, valueText(this.desk.known.get(name)!, series.get(name)?.[place]));
    }
  }

  /** Whoever does not see a plot hears what it shows and, while it stands still, from when to when. */
  private entitle(): void {
    const [min, max] = this.desk.stretch();
    const [first, ...others] = this.names;
    const time = this.desk.isPaused() ? ` from ${min.toFixed(2)} s to ${max.toFixed(2)} s` : "";
    const title = this.isOver ? `Plot of ${others.join(", ")} over ${first}${time}` : `Plot of ${this.names.join(", ")}${time}`;
    if (this.element.ariaLabel !== title) this.element.ariaLabel = title;
  }

  close(): void {
    this.observer.disconnect();
    this.chart?.destroy();
  }
}
