/** The frame around the views: state, who drives, emergency stop, and the way between views. */

import "./style.css";
import type { Context, View } from "./context";
import { may } from "./context";
import { capital, considerate, driver, isBusy, SETPOINTS } from "./driver";
import { watchHappenings } from "./happened";
import { call, CONFIRM_MS, get, live, type Session, type Signal } from "./net";
import { lateness } from "./overruns";
import { plotted } from "./plotted";
import { Wheel } from "./wheel";
import { action, alarm, alarmed, ask, field, h, micros, number, recall, setText, store, svg, toast } from "./ui";
import { diagnosisView } from "./views/diagnosis";
import { driveView } from "./views/drive";
import { signalsView } from "./views/signals";
import { timeView } from "./views/time";
import { tuneView } from "./views/tune";
import { watchView } from "./views/watch";
import { workStrip } from "./work";

const VIEWS: { id: string; name: string; icon: string; make: (context: Context) => View }[] = [
  { id: "drive", name: "Drive", icon: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18m0 6v12M3.5 10h17", make: driveView },
  { id: "watch", name: "Watch", icon: "M3 17l5-7 4 4 4-8 5 7M3 21h18", make: watchView },
  { id: "signals", name: "Signals", icon: "M4 6h16M4 12h16M4 18h16M8 4v4M15 10v4M10 16v4", make: signalsView },
  { id: "time", name: "Time", icon: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18m0 4v5l4 2", make: timeView },
  { id: "diagnosis", name: "Diagnosis", icon: "M11 4a7 7 0 1 0 0 14 7 7 0 0 0 0-14m5 12l5 5M8 11h2l1-3 2 5 1-2", make: diagnosisView },
  { id: "tune", name: "Tune", icon: "M4 6h9M17 6h3M4 12h3M11 12h9M4 18h11M19 18h1M15 4v4M9 10v4M17 16v4", make: tuneView },
];

function icon(path: string): SVGElement {
  return svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true", class: "icon" }, svg("path", { d: path }));
}

const stateChip = h("span", { class: "chip state", role: "status" });
const owner = h("span", { class: "owner", role: "status" });
const figures = h("dl", { class: "figures" });
const wheel = h("button", { type: "button", class: "wheel" });
const controller = h("button", { type: "button", hidden: true, onclick: () => void letControllerDrive() }, "Let the controller drive");
const main = h("main", { id: "main", tabindex: "-1" });
const banner = h("div", { class: "banner", role: "alert", hidden: true });
const links = VIEWS.map((view) =>
  h("a", { href: `#${view.id}` }, icon(view.icon), h("span", {}, view.name)),
);

let hands: Wheel | null = null;

/** The emergency stop, whatever else of the page works. */
async function emergencyStop(): Promise<void> {
  const begun = performance.now();
  const stopped = live.stop();
  hands?.halt();
  const late = window.setTimeout(() => alarm("stop", `Emergency stop sent, not confirmed: no tick shows it after ${CONFIRM_MS / 1000} s. Use the robot's own switch.`), CONFIRM_MS);
  try {
    await stopped;
    const text = "the robot stays in the safe state until you press Reset; a controller then waits for Start.";
    if (alarmed("stop")) alarm("stop", `Emergency stop confirmed after ${((performance.now() - begun) / 1000).toFixed(1)} s: ${text}`);
    else toast(`Emergency stop: ${text}`);
  } catch (error) {
    alarm("stop", `Emergency stop failed: ${(error as Error).message}`);
  } finally {
    window.clearTimeout(late);
  }
}

const stop = h(
  "button",
  { type: "button", class: "estop", "aria-keyshortcuts": "X", onclick: () => void emergencyStop() },
  h("strong", {}, "Stop"),
  h("small", {}, "emergency"),
);

function figure(name: string): HTMLElement {
  const value = h("dd", {}, "–");
  figures.append(h("div", {}, h("dt", {}, name), value));
  return value;
}

const factor = figure("Real time");
const margin = h("span", {}, "–");
const why = h("small", { class: "why" });
figure("Margin").replaceChildren(margin, why);
const battery = figure("Battery");

function header(context: Context): HTMLElement {
  const theme = h("button", { type: "button", class: "quiet theme", "aria-label": "Light or dark" }, "◐");
  theme.addEventListener("click", () => {
    const now = document.documentElement.dataset.theme;
    const dark = now ? now === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    document.documentElement.dataset.theme = dark ? "light" : "dark";
    store("page", { theme: document.documentElement.dataset.theme });
    window.dispatchEvent(new Event("themechange"));
  });
  wheel.addEventListener("click", () => void (live.drives ? give(giveTo()) : take()));
  const user = context.session.user;
  return h(
    "header",
    { class: "bar" },
    h("a", { class: "skip", href: "#main", onclick: (event: Event) => { event.preventDefault(); main.focus(); } }, "Skip to the view"),
    h("div", { class: "brand" }, h("img", { src: "./icon.svg", alt: "", width: 28, height: 28 }), h("b", {}, "hilserver")),
    stateChip,
    h("div", { class: "control" }, owner, wheel, controller),
    figures,
    user ? action(`Log out ${user}`, logOut, { class: "quiet" }) : "",
    theme,
    stop,
  );
}

async function take(): Promise<void> {
  const who = driver();
  if (who && isBusy() && !(await ask(`${capital(who)} is driving.`, `Take control from ${who}? The robot stops first.`, "Take over"))) return;
  try {
    await call("take", live.you, ...(live.slow.driver === null ? [] : [live.slow.driver]));
  } catch (error) {
    toast((error as Error).message, "error");
  }
}

async function give(source: string): Promise<void> {
  await call("give", source).catch((error: Error) => toast(error.message, "error"));
}

async function letControllerDrive(): Promise<void> {
  const who = isBusy() && driver() ? `${capital(driver())} is driving. ` : "";
  if (await ask("Let the controller drive?", `${who}The robot follows the controller's set-points at once.`, "Let it drive")) await give("peer");
}

async function logOut(): Promise<void> {
  await call("logout");
  location.reload();
}

function giveTo(): string {
  const { board } = live.slow;
  return Object.keys(board.peers ?? {}).length ? "peer" : "opcua";
}

function showBoard(context: Context): void {
  const { board } = live.slow;
  const state = !live.connected ? "offline" : live.stale ? "no answer" : (board.state ?? "starting");
  stateChip.dataset.state = live.connected && live.stale ? "offline" : state;
  setText(stateChip, state);
  stateChip.title = board.reason ?? "";
  const who = driver();
  if (live.stale) setText(owner, "Who drives is not known");
  else if (who === "you") setText(owner, "You drive");
  else setText(owner, `${capital(who || "nobody")} ${who && board.waits_for_start && board.owner !== "page" ? "waits" : "drives"}`);
  owner.title = live.drives ? "The arrow keys work in every view" : "";
  const hasController = Object.keys(board.peers ?? {}).length > 0;
  controller.hidden = live.stale || !context.session.drive || !hasController || live.drives || board.owner === "peer";
  owner.classList.toggle("you", live.drives && !live.stale);
  setText(wheel, live.drives ? "Give back" : "Take control");
  wheel.disabled = live.stale || !context.session.drive;
  setText(factor, board.realtime_factor == null ? "–" : `${board.realtime_factor.toFixed(2)}×`);
  const plant = board.slices?.["plant"];
  setText(margin, micros(plant?.["margin_last_us"] as number | null | undefined));
  const late = plant ? lateness("plant", plant) : "";
  margin.classList.toggle("warn", !!late);
  setText(why, late);
  margin.title = `Smallest so far: ${micros(plant?.["margin_min_us"] as number | null | undefined)}`;
}

function showAge(context: Context): void {
  if (document.body.classList.contains("stale") !== live.stale) showBoard(context);
  document.body.classList.toggle("stale", live.stale);
  const volts = live.value("battery.voltage_v");
  setText(battery, Number.isFinite(volts) ? `${number(volts)} V` : "–");
  const { board } = live.slow;
  const waits = board.state !== "safe" && board.waits_for_start && !live.drives; // a hand needs no Start
  let text = "";
  if (live.loggedOut) text = "The page has been restarted.";
  else if (!live.connected) text = "No connection to the page's server: the values shown are old. Reconnecting …";
  else if (live.stale) text = `No answer for ${(live.silentMs / 1000).toFixed(1)} s: what is shown is old.`;
  else if (board.state === "safe") text = `Safe state: ${board.reason || "stopped"}. The drive is off.`;
  else if (waits) text = "Waiting for Start: until then only a person drives.";
  const kind = text.replace(/[\d.]+ s/, ""); // its seconds count on, which is no new message
  if (banner.dataset.text === kind && text && banner.firstElementChild) setText(banner.firstElementChild, text);
  if (banner.dataset.text !== kind) {
    banner.dataset.text = kind;
    banner.hidden = !text;
    banner.classList.toggle("safe", !live.stale && (board.state === "safe" || !!waits));
    banner.replaceChildren(h("span", {}, text));
    // What waits for Start does not drive: only a person is asked for.
    const start = (): Promise<unknown> => (live.slow.driver === null ? call("Start") : considerate("Start", () => call("Start")));
    if (live.loggedOut) banner.append(h("a", { href: "./", onclick: () => location.reload() }, "Log in again"));
    else if (board.state === "safe" && !live.stale) banner.append(action("Reset", () => call("Reset"), { class: "primary" }));
    else if (waits && !live.stale) banner.append(action("Start", start, { class: "primary", disabled: !may(context, "Start") }));
  }
}

let current: View | null = null;

function show(context: Context): void {
  const id = location.hash.slice(1) || "drive";
  const view = VIEWS.find((each) => each.id === id) ?? VIEWS[0]!;
  context.wheel.letGo();
  current?.close();
  current = view.make(context);
  main.replaceChildren(h("h1", { class: "hidden" }, view.name), current.element);
  main.dataset.view = view.id;
  main.scrollTop = 0;
  document.title = `${view.name} – hilserver`;
  links.forEach((link, i) => {
    if (VIEWS[i] === view) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  });
}

function keys(event: KeyboardEvent): void {
  const target = event.target as HTMLElement;
  if (event.ctrlKey || event.metaKey || event.altKey || target.matches("input, textarea, select")) return;
  const place = "123456".indexOf(event.key);
  if (place >= 0) location.hash = VIEWS[place]!.id;
}

function login(session: Session): Promise<Session> {
  const name = h("input", { name: "name", autocomplete: "username", required: true });
  const password = h("input", { name: "password", type: "password", autocomplete: "current-password" });
  const problem = h("p", { class: "problem", role: "alert" });
  const form = h(
    "form",
    { class: "login panel" },
    h("h1", {}, "hilserver"),
    field("Name", name),
    field("Password", password),
    problem,
    h("button", { class: "primary", type: "submit" }, "Log in"),
  );
  document.body.replaceChildren(h("main", {}, form));
  name.focus();
  setText(problem, session.problem === "log in first" ? "" : session.problem);
  return new Promise((resolve) => {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        resolve(await call<Session>("login", name.value, password.value));
      } catch (error) {
        setText(problem, (error as Error).message);
        password.value = "";
      }
    });
  });
}

async function start(): Promise<void> {
  const { theme } = recall<{ theme: string }>("page");
  if (theme) document.documentElement.dataset.theme = theme;
  let session = await call<Session>("session");
  if (session.needs_login) session = await login(session);
  const [table, hall] = await Promise.all([
    get<{ signals: Signal[] }>("signals"),
    get<Pick<Context, "walls" | "robot" | "faults">>("hall"),
  ]);
  hands = new Wheel(hall.robot, () => void emergencyStop());
  const context: Context = { session, signals: table.signals, ...hall, wheel: hands };
  document.body.replaceChildren(
    header(context),
    banner,
    workStrip(),
    h("nav", { "aria-label": "Views", class: "rail" }, ...links),
    main,
  );
  if (session.problem) toast(session.problem, "error");
  stop.disabled = !may(context, "Stop");
  live.onReturn = () => void returned(context, JSON.stringify(table));
  live.onLate = (method) => toast(`${method}: sent, not confirmed yet.`, "error");
  live.onRefused = (text) => toast(text, "error");
  live.onSlow(() => showBoard(context));
  live.want("frame", ["battery.voltage_v", "sim.state", "sim.time_s", "control.mode", ...SETPOINTS.flat().filter((name) => table.signals.some((signal) => signal.name === name))]);
  plotted.begin(table.signals);
  watchHappenings();
  window.setInterval(() => showAge(context), 200);
  window.addEventListener("hashchange", () => show(context));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => window.dispatchEvent(new Event("themechange")));
  window.addEventListener("keydown", keys);
  showBoard(context);
  show(context);
  await live.connect();
}

/** The daemon may have been started anew meanwhile, perhaps with other signals or for another role. */
async function returned(context: Context, known: string): Promise<void> {
  const [session, table] = await Promise.all([call<Session>("session"), get("signals")]);
  if (JSON.stringify(table) !== known || session.drive !== context.session.drive) location.reload();
}

start().catch((error: Error) => {
  document.body.replaceChildren(
    h("main", {}, h("div", { class: "login panel" }, h("h1", {}, "hilserver"), h("p", { role: "alert" }, error.message), action("Try again", async () => location.reload()))),
  );
});
