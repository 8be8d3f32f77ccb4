/** Two recordings over each other: what parts first is on top; one cursor reads all plots. */

import uPlot from "uplot";
import { get } from "../net";
import { h, number, setText, signalName } from "../ui";
import { axisOf, colour, colours, sensible } from "./plot";

const HEIGHT = 180;
/** Below the largest difference; smaller ones are at the foot of their logarithmic axis. */
const DECADES = 16;

interface Curve {
  name: string;
  unit: string;
  parts_at_s: number;
  a: (number | null)[];
  b: (number | null)[];
  difference: (number | null)[];
}

interface Comparison {
  text: string;
  t_s: number[];
  signals: Curve[];
}

export interface Compared {
  element: HTMLElement;
  show(folder: string): Promise<void>;
  close(): void;
}

export function compared(): Compared {
  const text = h("pre", { tabindex: "0", "aria-label": "What differs" });
  const plots = h("div", { class: "plots" });
  const element = h("section", { class: "panel compared", "aria-label": "Comparison", hidden: true }, text, plots);
  let charts: uPlot[] = [];
  const observer = new ResizeObserver(() => {
    for (const chart of charts) chart.setSize({ width: plots.clientWidth, height: HEIGHT });
  });
  observer.observe(plots);

  function close(): void {
    for (const chart of charts) chart.destroy();
    charts = [];
  }

  async function show(folder: string): Promise<void> {
    const found = await get<Comparison>(`reports/${encodeURIComponent(folder)}/comparison.json`);
    close();
    element.hidden = false;
    setText(text, found.text);
    const sync = uPlot.sync(folder); // plots of another comparison have another cursor
    plots.replaceChildren();
    for (const curve of found.signals) {
      const holder = h("div", { class: "canvas" });
      const reading = h("output", {});
      const title = `${curve.name} of A and B, which differ from ${curve.parts_at_s.toFixed(3)} s on`;
      plots.append(h("section", { class: "plot", "aria-label": title }, head(curve, reading), holder));
      charts.push(draw(found.t_s, curve, holder, reading, sync.key));
    }
  }

  return { element, show, close: () => { close(); observer.disconnect(); } };
}

function head(curve: Curve, reading: HTMLElement): HTMLElement {
  const [ofA, ofB] = colours();
  const line = (name: string, of: string): HTMLElement => {
    const swatch = h("span", { class: "swatch", "aria-hidden": "true" });
    swatch.style.background = of;
    return h("span", { class: "legend" }, swatch, name);
  };
  return h("div", { class: "plot-head" }, signalName(curve.name), line("A", ofA!), line("B", ofB!), line("difference", colour("--muted")), reading);
}

function draw(t_s: number[], curve: Curve, holder: HTMLElement, reading: HTMLElement, key: string): uPlot {
  const [ofA, ofB] = colours();
  const axis = axisOf();
  const unit = curve.unit === "1" ? "" : curve.unit;
  const sizes = curve.difference.map((size) => size || null); // a logarithm has no zero
  const largest = sizes.reduce<number>((most, size) => Math.max(most, size ?? 0), 0) || 1;
  const top = Math.ceil(Math.log10(largest));
  const decades = (low: number | null): [number, number] => [10 ** Math.max(Math.min(Math.floor(Math.log10(low || largest)), top - 1), top - DECADES), 10 ** top];
  const line = { width: 1.6, points: { show: false } };

  function read(chart: uPlot): void {
    const at = chart.cursor.idx;
    if (at == null) return setText(reading, "");
    const values = [curve.a, curve.b, curve.difference].map((values) => number(values[at]));
    setText(reading, `at ${t_s[at]!.toFixed(3)} s: A ${values[0]}, B ${values[1]}, difference ${small(curve.difference[at])} ${unit}`);
  }

  return new uPlot(
    {
      width: Math.max(holder.clientWidth, 200),
      height: HEIGHT,
      legend: { show: false },
      cursor: { y: false, drag: { x: true, y: false }, sync: { key } },
      scales: {
        x: { time: false },
        value: { range: (_, low, high) => sensible(low, high) },
        size: { distr: 3, range: (_, low) => decades(low) },
      },
      axes: [
        { ...axis, size: 30, values: (_, ticks) => ticks.map((t) => `${Number(t.toFixed(6))} s`) },
        { ...axis, scale: "value", size: 56, label: unit },
        { ...axis, scale: "size", side: 1, size: 64, grid: { show: false }, values: (_, ticks) => ticks.map((size) => (size && Number.isInteger(Math.log10(size)) ? size.toExponential(0) : "")) },
      ],
      series: [
        {},
        { scale: "size", stroke: colour("--muted"), ...line, width: 1 },
        { scale: "value", stroke: ofA!, ...line },
        { scale: "value", stroke: ofB!, ...line, dash: [6, 4] },
      ],
      hooks: { setCursor: [read], draw: [(chart) => parting(chart, curve.parts_at_s)] },
    },
    [t_s, sizes, curve.a, curve.b] as uPlot.AlignedData,
    holder,
  );
}

function small(size: number | null | undefined): string {
  if (size == null) return "–";
  return size !== 0 && size < 0.001 ? size.toExponential(2) : number(size);
}

/** Where they part: a line from top to bottom. */
function parting(chart: uPlot, t: number): void {
  const { ctx, bbox } = chart;
  const x = Math.round(chart.valToPos(t, "x", true));
  if (x < bbox.left || x > bbox.left + bbox.width) return;
  ctx.save();
  ctx.strokeStyle = colour("--red-ink");
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(x, bbox.top);
  ctx.lineTo(x, bbox.top + bbox.height);
  ctx.stroke();
  ctx.restore();
}
