/** Elements, messages and numbers: what every view is made of. */

import { live, type Signal } from "./net";

type Child = Node | string | null | false | undefined;
type Attributes = Record<string, unknown>;

/** Make an element; `on...` are listeners, `true` a bare attribute. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value as EventListener);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((child): child is Node | string => !!child));
  return element;
}

export function svg(tag: string, attributes: Attributes, ...children: Node[]): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/** Write text only when it is another one: nothing is drawn when nothing changes. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

const shelf = h("div", { class: "toasts", role: "status", "aria-live": "polite" });

/** Say something for some seconds; errors are read out at once. */
export function toast(text: string, kind: "info" | "error" = "info"): void {
  if (!shelf.isConnected) document.body.append(shelf);
  for (const old of [...shelf.children]) if (old.textContent === text) old.remove();
  while (shelf.children.length > 3) shelf.firstElementChild?.remove();
  const note = h("div", { class: `toast ${kind}` }, text);
  if (kind === "error") note.setAttribute("role", "alert");
  shelf.append(note);
  window.setTimeout(() => note.remove(), kind === "error" ? 6000 : 3000);
}

const alarms = new Map<string, HTMLElement>();
const alarmShelf = h("div", { class: "alarms" });

interface Alarm {
  /** News rather than a fault. */
  calm?: boolean;
  /** Where more is to be read, and what that link says. */
  href?: string;
  label?: string;
  onSeen?: () => void;
}

/** Say something that stays until it is acknowledged; a later one of the same kind takes its place. */
export function alarm(kind: string, text: string, { calm, href, label, onSeen }: Alarm = {}): void {
  if (!alarmShelf.isConnected) document.body.append(alarmShelf);
  const known = alarms.get(kind);
  const note = h("div", { class: calm ? "alarm calm" : "alarm", role: "alert" }, h("p", {}, text));
  const close = (): void => {
    note.remove();
    alarms.delete(kind);
    onSeen?.();
  };
  if (href) note.append(h("a", { href, onclick: close }, label ?? "Show"));
  note.append(h("button", { type: "button", onclick: close }, "Understood"));
  alarms.set(kind, note);
  if (known) known.replaceWith(note);
  else alarmShelf.append(note);
}

export function alarmed(kind: string): boolean {
  return alarms.has(kind);
}

const integers = new Set(["Byte", "UInt32", "Int64"]);

/** A number as an instrument shows it: four significant digits, steady width. */
export function number(value: number | null | undefined, type = "Double"): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (type === "Boolean") return value ? "on" : "off";
  if (integers.has(type)) return String(Math.round(value));
  const size = Math.abs(value);
  if (size >= 100000) return value.toExponential(2);
  const digits = size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : 3;
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
}

/** A value as a reader wants it: by its name where it has one. */
export function valueText({ type, labels }: Signal, value: number | null | undefined): string {
  return labels[value ?? -1] ?? number(value, type);
}

/** Microseconds in the unit a reader expects. */
export function micros(value: number | null | undefined): string {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  if (size >= 1e6) return `${number(value / 1e6)} s`;
  if (size >= 1000) return `${number(value / 1000)} ms`;
  return `${number(value)} µs`;
}

export function bytes(value: number): string {
  if (value < 1024) return `${value} B`;
  if (value < 1 << 20) return `${(value / 1024).toFixed(0)} kB`;
  return `${(value / (1 << 20)).toFixed(1)} MB`;
}

/** Local time of day, to the second. */
export function timeOfDay(utcMs: number): string {
  return Number.isFinite(utcMs) ? new Date(utcMs).toLocaleTimeString("en-GB") : "–";
}

/** Date and time as names of files carry them: in UTC, and saying so. */
export function stamp(): string {
  return `${new Date(live.utcMs).toISOString().slice(0, 19).replaceAll(":", "-")}Z`;
}

export function seconds(value: number): string {
  if (value < 10) return `${value.toFixed(1)} s`;
  if (value < 120) return `${value.toFixed(0)} s`;
  return value < 7200 ? `${(value / 60).toFixed(0)} min` : `${(value / 3600).toFixed(0)} h`;
}

/** Keep something in this browser; a private window keeps nothing. */
export function store(key: string, value: unknown): void {
  try {
    localStorage.setItem(key, JSON.stringify(value));
  } catch {
    /* then it is gone with the page */
  }
}

/** What was kept, as far as it can be read. */
export function recall<T>(key: string): Partial<T> {
  try {
    return (JSON.parse(localStorage.getItem(key) ?? "null") as Partial<T> | null) ?? {};
  } catch {
    return {};
  }
}

/** Put text on the clipboard, where the page is not encrypted, too. */
export async function copy(text: string): Promise<void> {
  if (navigator.clipboard) return navigator.clipboard.writeText(text);
  const area = h("textarea", { class: "hidden" });
  area.value = text;
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  if (!done) throw new Error("This browser does not allow copying.");
}

/** The name of a signal, which a narrow column breaks between its words. */
export function signalName(name: string): HTMLElement {
  return h("code", {}, ...name.split(/(?<=[._])/).flatMap((word) => [h("wbr"), word]));
}

export type Quality = "good" | "forced" | "uncertain" | "bad";

const NAMES: Record<number, string> = {
  0x00000000: "Good",
  0x00960000: "Forced",
  0x40000000: "Uncertain",
  0x408f0000: "No contact",
  0x40900000: "Last known",
  0x80320000: "Waiting",
  0x808d0000: "Off",
};

export function quality(status: number): Quality {
  if (status === 0x00960000) return "forced";
  return status >= 0x80000000 ? "bad" : status >= 0x40000000 ? "uncertain" : "good";
}

export function qualityName(status: number): string {
  return NAMES[status] ?? (status >= 0x80000000 ? "Bad" : status >= 0x40000000 ? "Uncertain" : "Good");
}

/** A button that is busy while its work runs, and says why it failed. */
export function action(
  label: string,
  work: () => Promise<unknown>,
  attributes: Attributes = {},
): HTMLButtonElement {
  const button = h("button", { type: "button", ...attributes }, label);
  button.addEventListener("click", async () => {
    if (button.getAttribute("aria-busy") === "true") return;
    button.setAttribute("aria-busy", "true");
    try {
      await work();
    } catch (error) {
      toast((error as Error).message, "error");
    } finally {
      button.removeAttribute("aria-busy");
    }
  });
  return button;
}

/** A button that stores a log on the reader's computer. */
export function download(name: string): HTMLButtonElement {
  const link = h("a", { href: `./api/logs/${encodeURIComponent(name)}`, download: name });
  return h("button", { type: "button", class: "quiet", "aria-label": `Download ${name}`, onclick: () => link.click() }, "Download");
}

/** Ask before something is done; whether it may be. The emergency stop stays in reach meanwhile. */
export function ask(title: string, text: string, yes: string, ...more: Child[]): Promise<boolean> {
  const dialog = h("dialog", { class: "panel ask", "aria-label": title });
  const close = (answer: string) => (): void => dialog.close(answer);
  dialog.append(
    h("h2", {}, title),
    h("p", {}, text),
    ...more.filter((child): child is Node | string => !!child),
    h("div", { class: "buttons" }, h("button", { type: "button", class: "primary", onclick: close("yes") }, yes), h("button", { type: "button", onclick: close("") }, "Cancel")),
  );
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "Escape") dialog.close("");
  });
  for (const other of document.querySelectorAll<HTMLDialogElement>("dialog.ask")) other.close("");
  document.body.append(dialog);
  dialog.show();
  dialog.querySelector<HTMLElement>("select, .primary")?.focus();
  return new Promise((resolve) =>
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    }),
  );
}

export function field(label: string, control: HTMLElement, hint = ""): HTMLElement {
  return h("label", { class: "field" }, h("span", {}, label), control, hint && h("small", {}, hint));
}
