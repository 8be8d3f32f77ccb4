/** Watch: signals as live plots, the time slices, the peers. */

import type { Context, View } from "../context";
import { happenedAt } from "../happened";
import { live } from "../net";
import { plotted, SPANS_S } from "../plotted";
import { bytes, h, setText, signalName, stamp, timeOfDay, toast } from "../ui";
import { peerCard, sliceCard } from "./cards";
import { Plot, type Desk } from "./plot";

/** An event is at the cursor within this share of a plot. */
const NEAR = 0.015;
/** Digits of exported times: a tick is no shorter than 100 µs. */
const TIME_DIGITS = 6;

export function watchView(context: Context): View {
  const { history, groups } = plotted;
  const known = new Map(context.signals.map((signal) => [signal.name, signal]));
  const plots: Plot[] = [];
  let stood: [number, number] | null = null; // the stretch that is shown while the plots stand still
  let cursorT: number | null = null; // where they are read then
  let hovered: number | null = null; // the place under the mouse
  let plotsDue = 0;

  const last = (): number => history.times[history.times.length - 1] ?? 0;
  const running = (): [number, number] => [last() - plotted.windowS, last()];
  const desk: Desk = {
    known,
    isPaused: () => stood !== null,
    place: () => hovered ?? (cursorT === null ? null : history.placeOf(cursorT)),
    stretch: () => stood ?? running(),
    grasp: stand,
    show: stretch,
    marked(min, max) {
      stand(Math.min(max, last()));
      stretch(min, max);
    },
    hover(place) {
      hovered = place;
      if (place !== null && stood) mark(history.times[place]!); // keys go on from there
      showMoment();
      for (const plot of plots) plot.readings();
    },
    remove(plot) {
      groups.splice(groups.indexOf(plot.names), 1);
      plots.splice(plots.indexOf(plot), 1);
      plot.close();
      plot.element.remove();
      plotted.changed();
    },
  };

  function open(names: string[]): void {
    const plot = new Plot(names, desk);
    plots.push(plot);
    board.insertBefore(plot.element, dropHere);
  }

  function add(name: string): void {
    const names = [name];
    groups.push(names);
    plotted.changed();
    open(names);
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

  const pause = h("button", { type: "button", "aria-pressed": "false", onclick: () => (stood ? go() : stand()) }, "Pause");
  const cursor = h("input", { type: "range", min: 0, class: "cursor", "aria-label": "Cursor", hidden: true });
  const moment = h("output", { class: "moment" });
  const then = h("span", { class: "hint then" });
  cursor.addEventListener("input", () => seek(history.times[Number(cursor.value)] ?? last()));

  function showPause(): void {
    pause.setAttribute("aria-pressed", String(stood !== null));
    setText(pause, stood ? "Resume" : "Pause");
    cursor.hidden = !stood;
  }

  /** Where the plots are read: on both clocks, with what happened there. */
  function showMoment(): void {
    const place = desk.place();
    const t = place === null ? undefined : history.times[place];
    if (t === undefined) return [moment, then].forEach((element) => setText(element, ""));
    const ms = history.utcMs[place!] ?? NaN;
    setText(moment, `${t.toFixed(3)} s${Number.isFinite(ms) ? `, ${timeOfDay(ms)}` : ""}`);
    const [min, max] = desk.stretch();
    const asked = hovered === null ? (cursorT ?? t) : t; // between two frames, as an event is
    setText(then, happenedAt(asked, NEAR * (max - min))?.text ?? "");
  }

  function go(): void {
    stood = cursorT = null;
    showPause();
    showMoment();
    redraw();
  }

  /** Let the plots stand; what comes in is kept all the same, and the cursor reaches all of it. */
  function stand(t = last()): void {
    stood ??= running();
    showPause();
    seek(t);
  }

  function mark(t: number): void {
    cursorT = t;
    cursor.max = String(Math.max(0, history.times.length - 1));
    cursor.value = String(history.placeOf(t));
  }

  /** Read all plots at a time, and show it. */
  function seek(t: number): void {
    mark(t);
    const [min, max] = desk.stretch();
    if (t < min || t > max) stood = [t - (max - min) / 2, t + (max - min) / 2];
    redraw();
    for (const plot of plots) plot.point();
    showMoment();
  }

  /** Show a stretch of what was seen, in all plots. */
  function stretch(min: number, max: number): void {
    const first = history.times[0] ?? 0;
    const span = Math.min(max - min, last() - first);
    const from = Math.max(first, Math.min(min, last() - span));
    stood = [from, from + span];
    redraw();
    for (const plot of plots) plot.point();
  }

  function redraw(): void {
    for (const plot of plots) plot.draw();
  }

  const span = h("select", { "aria-label": "Length of the plots" }, ...SPANS_S.map((s) => h("option", { value: s, selected: s === plotted.windowS }, s < 600 ? `${s} s` : `${s / 60} min`)));
  span.addEventListener("change", () => {
    plotted.windowS = Number(span.value);
    plotted.save();
    if (stood) stretch(stood[1] - plotted.windowS, stood[1]);
  });
  const save = h("button", { type: "button", onclick: exported }, "Export CSV");

  function exported(): void {
    const names = [...new Set(groups.flat())];
    const lines = history.times.map((t, i) => [t.toFixed(TIME_DIGITS), ...names.map((name) => history.series.get(name)?.[i] ?? "")].join(","));
    const blob = new Blob([["t_s", ...names].join(",") + "\n" + lines.join("\n") + "\n"], { type: "text/csv" });
    const link = h("a", { href: URL.createObjectURL(blob), download: `watch-${stamp()}.csv` });
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

  function slow(): void {
    const { board: told } = live.slow;
    slices.replaceChildren(...Object.entries(told.slices ?? {}).map(([name, slice]) => sliceCard(name, slice, told.bounds_us ?? [])));
    const entries = Object.entries(told.peers ?? {});
    peers.replaceChildren(...(entries.length ? entries.map(([name, peer]) => peerCard(name, peer)) : [h("p", { class: "note" }, "No peers are configured.")]));
    if (cursorT !== null && document.activeElement !== cursor) mark(cursorT); // the history has grown
  }

  groups.forEach((group) => open(group));
  slow();
  plotted.onMerged = redraw;
  if (plotted.goTo !== null) stand(plotted.goTo);
  plotted.goTo = null;
  const stopFrames = live.onFrame(() => {
    if (stood || plotsDue) return;
    plotsDue = requestAnimationFrame(() => {
      plotsDue = 0;
      redraw();
    });
  });
  const stopSlow = live.onSlow(slow);
  const retheme = (): void => plots.forEach((plot) => plot.build());
  window.addEventListener("themechange", retheme);

  const element = h(
    "div",
    { class: "watch" },
    h("aside", { class: "panel chooser", "aria-label": "Choose signals" }, search, list),
    h("div", { class: "column" },
      h("div", { class: "tools" }, pause, cursor, span, save, moment, then,
        h("span", { class: "hint mouse" }, "Wheel or drag to zoom, double-click to see all."), h("span", { class: "hint touch" }, "Drag a plot with one finger, stretch it with two.")),
      board,
      h("h2", {}, "Time slices"), slices, h("h2", {}, "Peers"), peers),
  );
  return {
    element,
    close() {
      stopFrames();
      stopSlow();
      cancelAnimationFrame(plotsDue);
      window.removeEventListener("themechange", retheme);
      plotted.onMerged = () => {};
      plots.forEach((plot) => plot.close());
    },
  };
}
