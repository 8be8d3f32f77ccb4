/** Cards of the time slices and the peers. */

import type { Figures, Slice } from "../net";
import { grewLately, OVERRUNS } from "../overruns";
import { h, micros, number, seconds } from "../ui";

function rows(pairs: [string, string, boolean?][]): HTMLElement {
  return h("dl", { class: "pairs" }, ...pairs.map(([name, value, warn]) => h("div", { class: warn ? "warn" : "" }, h("dt", {}, name), h("dd", {}, value))));
}

function figure(value: unknown): number | null {
  return typeof value === "number" ? value : null;
}

export function sliceCard(name: string, slice: Slice, bounds: number[]): HTMLElement {
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
      ["margin, smallest", us("margin_min_us")],
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

export function peerCard(name: string, peer: Figures): HTMLElement {
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
