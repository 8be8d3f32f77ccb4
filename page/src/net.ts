/** The way to the daemon: calls, the live socket, frames. */

export interface Signal {
  name: string;
  unit: string;
  type: string;
  writable: boolean;
  low: number;
  high: number;
  description: string;
  /** Names of the values 0, 1, ...; empty without. */
  labels: string[];
}

export interface Session {
  user: string;
  needs_login: boolean;
  problem: string;
  drive: boolean;
  methods: string[];
  rate_hz: number;
  deadman_ms: number;
}

export type Figures = Record<string, number | string | boolean | null>;

export interface Slice extends Record<string, unknown> {
  period_ms: number;
  count: number;
  latency_counts: number[];
}

/** The gap in one quantity, with the model before and with the other. */
export interface Gain {
  before: number;
  after: number;
  ratio: number;
}

/** What an engineer decides on; `stage` says where it is. */
export interface Proposal {
  number: number;
  causes: string[];
  sentence: string;
  terms: Record<string, { value: number; unit: string; ci95: [number, number] | null; present: number | null }>;
  gone: Record<string, number>;
  gain: Record<string, Gain>;
  effect: Record<string, Gain>;
  stage: string;
  windows: number[];
}

/** Something that happened; of the overruns of a slice the newest one, and how many there were. */
export interface Happening {
  age_s: number;
  monotonic_s: number;
  /** Simulated time then; null: not known. */
  simulated_s: number | null;
  kind: string;
  severity: number;
  source: string;
  text: string;
  count: number;
}

export interface Board {
  version: string;
  /** When all this was so, on two clocks of the daemon's computer. */
  monotonic_s: number;
  utc_s: number;
  state: string;
  reason: string;
  waits_for_start: boolean;
  speed: number;
  owner: string;
  opcua_wrote: boolean;
  realtime_factor: number | null;
  bounds_us: number[];
  slices: Record<string, Slice>;
  peers: Record<string, Figures>;
  audit: Record<string, Figures>;
  faults: { name: string; fault: string; place: string; acts: boolean }[];
  gaps: Record<string, number>;
  patch: string | null;
  patch_notice?: string | null;
  recalibration?: { look: Record<string, string | number | boolean>; proposal: Proposal | null } | null;
  recording?: { name: string; bytes: number } | null;
  scenario?: { name: string; seconds: number; length_s: number } | null;
  events: Happening[];
}

export interface Job {
  number: number;
  kind: "diagnosis" | "comparison";
  log: string;
  state: string;
  share: number;
  stage: string;
  text: string;
  folder: string;
  files: string[];
  /** Whether it gets hardly any time because others take it. */
  waits: boolean;
  /** The mapping that a diagnosis has guessed for a log whose columns it does not know. */
  mapping: string;
}

export interface Slow {
  board: Partial<Board>;
  driver: number | null;
  clients: number;
  jobs: Job[];
  /** Of the board, when it was sent. */
  age_s: number;
}

export interface Reading {
  value: number;
  status: number;
}

const metaToken = (page: Document): string => page.querySelector<HTMLMetaElement>('meta[name="token"]')?.content ?? "";
const asked = new Set<AbortController>();
let token = metaToken(document);
let renewing: Promise<void> | null = null;

/** The server was started again and knows us no more: become a new browser to it. */
function renew(): Promise<void> {
  const load = async (): Promise<void> => {
    const text = await (await fetch("./", { cache: "no-store" })).text();
    token = metaToken(new DOMParser().parseFromString(text, "text/html"));
  };
  return (renewing ??= load().finally(() => (renewing = null)));
}

/** One request; who is not known any more tries again as a new browser. */
async function request(path: string, limitMs: number, init: () => RequestInit): Promise<Response> {
  for (let tries = 0; ; tries++) {
    const controller = new AbortController();
    const timer = window.setTimeout(() => controller.abort(), limitMs);
    asked.add(controller);
    try {
      const response = await fetch(path, { ...init(), signal: controller.signal });
      if (tries || (response.status !== 401 && response.status !== 403)) return response;
      await renew();
    } catch {
      throw new Error("The page's server does not answer.");
    } finally {
      window.clearTimeout(timer);
      asked.delete(controller);
    }
  }
}

async function post<T>(limitMs: number, method: string, args: unknown[], body?: Blob): Promise<T> {
  const response = await request(body ? `./api/logs/${encodeURIComponent(String(args[0]))}` : "./api/call", limitMs, () => ({
    method: "POST",
    headers: {
      "Content-Type": body ? "application/octet-stream" : "application/json",
      "X-Hilserver-Token": token,
      ...(live.serverMs !== null && { "X-Hilserver-Sent": String(live.serverMs) }),
    },
    body: body ?? JSON.stringify({ method, arguments: args }),
  }));
  const text = await response.text();
  if (!response.headers.get("Content-Type")?.startsWith("application/json")) throw new Error(text);
  const answer = JSON.parse(text) as { ok: boolean; text?: string; result?: T };
  if (answer.text === "log in first") live.loggedOut = true;
  if (!answer.ok) throw new Error(answer.text ?? "refused");
  return answer.result as T;
}

/** Send a log; throws with the sentence that says why not. */
export function upload(file: File): Promise<number> {
  return post<number>(UPLOAD_MS, "upload", [file.name], file);
}

/** Ask the server to do something; throws with the sentence that says why not. */
export async function call<T = unknown>(method: string, ...args: unknown[]): Promise<T> {
  const late = window.setTimeout(() => QUIET.has(method) || live.onLate(method), CONFIRM_MS);
  try {
    return await post<T>(CALL_MS, method, args);
  } finally {
    window.clearTimeout(late);
  }
}

export async function get<T>(path: string): Promise<T> {
  const response = await request(`./api/${path}`, CALL_MS, () => ({}));
  if (!response.ok) throw new Error(await response.text());
  return (await response.json()) as T;
}

const VERSION = 2;
const HEAD_BYTES = 24;
/** What is older is shown as old. */
const STALE_MS = 1000;
/** Until a request that was not answered is called unconfirmed. */
export const CONFIRM_MS = 1000;
const QUIET = new Set(["session", "ticket", "login", "logout"]);
const CALL_MS = 20_000;
const UPLOAD_MS = 3_600_000;
const STOP_SOCKET_MS = 200;
const STOP_REQUEST_MS = 1500;
const STOP_TRIES = 5;

type Listener = () => void;

/** Everything live: one socket that comes back by itself. */
export class Live {
  readonly values = new Map<string, Reading>();
  slow: Slow = { board: {}, driver: null, clients: 0, jobs: [], age_s: 0 };
  you = 0;
  tick = 0;
  connected = false;
  lastFrame = 0;
  onRefused: (text: string) => void = () => {};
  /** Called with what was asked for, if it is not answered within `CONFIRM_MS`. */
  onLate: (method: string) => void = () => {};
  /** Called whenever the socket is there again. */
  onReturn: () => void = () => {};
  /** Whether the server wants a name and a password before it shows anything. */
  loggedOut = false;
  private stops = new Map<number, { pressed: () => void; shown: () => void; lost: () => void }>();
  private stopNumber = 0;
  private socket: WebSocket | null = null;
  private stamp = 0;
  private tickAgeMs = 0;
  private lastSlow = 0;
  private utcAheadMs = 0;
  private wanted = new Map<string, Set<string>>();
  private names: string[] = [];
  private number = 0;
  private pending = 0;
  private retryMs = 250;
  private frameListeners = new Set<Listener>();
  private slowListeners = new Set<Listener>();

  /** Call `listener` after every frame; returns what ends that. */
  onFrame(listener: Listener): Listener {
    this.frameListeners.add(listener);
    return () => this.frameListeners.delete(listener);
  }

  onSlow(listener: Listener): Listener {
    this.slowListeners.add(listener);
    return () => this.slowListeners.delete(listener);
  }

  /** What one part of the page wants to see; an empty list lets go. */
  want(part: string, names: Iterable<string>): void {
    const set = new Set(names);
    if (set.size) this.wanted.set(part, set);
    else this.wanted.delete(part);
    window.clearTimeout(this.pending);
    this.pending = window.setTimeout(() => this.subscribe(), 20);
  }

  get(name: string): Reading | undefined {
    return this.values.get(name);
  }

  /** Value of a signal, `NaN` while it has none. */
  value(name: string): number {
    const reading = this.values.get(name);
    return reading === undefined || reading.status >= 0x80000000 ? NaN : reading.value;
  }

  /** Age of the tick that is shown. */
  get ageMs(): number {
    return this.tickAgeMs + performance.now() - this.lastFrame;
  }

  /** How old what is shown is: the tick, unless time stands still, and the board. */
  get silentMs(): number {
    const boardMs = this.slow.age_s * 1000 + performance.now() - this.lastSlow;
    const ticks = this.lastFrame > 0 && this.slow.board.state !== "paused";
    return Math.max(this.lastSlow > 0 ? boardMs : 0, ticks ? this.ageMs : 0);
  }

  get stale(): boolean {
    return !this.connected || this.silentMs > STALE_MS;
  }

  /** UTC now by the clock of the daemon's computer [ms since 1970]. */
  get utcMs(): number {
    return Date.now() + this.utcAheadMs;
  }

  /** When something happened, by the clock of the daemon's computer [ms since 1970]. */
  utcMsOf(event: Happening): number {
    const { utc_s = 0, monotonic_s = 0 } = this.slow.board;
    return (utc_s - monotonic_s + event.monotonic_s) * 1000;
  }

  /** The time now by the clock of the page's server, as far as a frame has told it. */
  get serverMs(): number | null {
    return this.lastFrame ? Math.round(this.stamp + performance.now() - this.lastFrame) % 2 ** 32 : null;
  }

  get drives(): boolean {
    return this.connected && this.slow.driver === this.you && this.slow.board.owner === "page";
  }

  drive(command: Record<string, unknown>): void {
    if (this.socket?.readyState === WebSocket.OPEN) {
      this.socket.send(JSON.stringify({ drive: { ...command, seen: Math.max(0, Math.round(this.stamp - this.tickAgeMs)) } }));
    }
  }

  /**
   * Stop the robot: over the open socket, and where that does not answer by a request of its own. Ends when a tick
   * shows the stop; throws if the stop could not even be pressed, or no tick came for long.
   */
  async stop(): Promise<void> {
    const number = ++this.stopNumber;
    if (this.socket?.readyState === WebSocket.OPEN) {
      let shown: Promise<boolean> | undefined;
      const pressed = await new Promise<boolean>((resolve) => {
        shown = new Promise<boolean>((done) =>
          this.stops.set(number, { pressed: () => resolve(true), shown: () => done(true), lost: () => done(false) }));
        window.setTimeout(() => resolve(false), STOP_SOCKET_MS);
        this.socket!.send(JSON.stringify({ stop: number }));
      });
      const done = pressed && (await shown);
      this.stops.delete(number);
      if (done) return;
    }
    for (const controller of asked) controller.abort(); // a browser has few connections to one server
    for (let tries = 1; ; tries++) {
      try {
        if (await post<boolean>(STOP_REQUEST_MS, "Stop", [])) return;
        if (tries === STOP_TRIES) throw new Error("it is pressed, but the plant does not show it.");
      } catch (error) {
        if (tries === STOP_TRIES) throw error;
      }
    }
  }

  async connect(): Promise<void> {
    try {
      const ticket = await call<string>("ticket");
      this.loggedOut = false;
      const url = new URL("./api/live", location.href);
      url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
      const socket = new WebSocket(url);
      socket.binaryType = "arraybuffer";
      socket.onopen = () => socket.send(JSON.stringify({ ticket }));
      socket.onmessage = (event) => this.receive(event.data);
      socket.onclose = () => this.lost();
      this.socket = socket;
    } catch (error) {
      this.loggedOut = (error as Error).message === "log in first";
      this.again();
    }
  }

  private lost(): void {
    for (const { lost } of this.stops.values()) lost();
    this.connected = false;
    this.socket = null;
    this.tell(this.slowListeners);
    this.again();
  }

  private again(): void {
    window.setTimeout(() => void this.connect(), this.retryMs);
    this.retryMs = Math.min(this.retryMs * 2, 5000);
  }

  private receive(data: ArrayBuffer | string): void {
    if (typeof data !== "string") return this.frame(data);
    const message = JSON.parse(data);
    if (message.type === "welcome") {
      this.you = message.you;
      this.connected = true;
      this.retryMs = 250;
      this.subscribe();
      this.onReturn();
    } else if (message.type === "pressed") {
      this.stops.get(message.number)?.pressed();
    } else if (message.type === "stopped") {
      this.stops.get(message.number)?.pressed();
      this.stops.get(message.number)?.shown();
    } else if (message.type === "refused") {
      this.onRefused(message.text);
    } else {
      this.slow = message as Slow;
      this.lastSlow = performance.now();
      const { utc_s } = this.slow.board;
      if (utc_s !== undefined) this.utcAheadMs = (utc_s + this.slow.age_s) * 1000 - Date.now();
    }
    this.tell(this.slowListeners);
  }

  private subscribe(): void {
    const names = new Set<string>();
    for (const set of this.wanted.values()) for (const name of set) names.add(name);
    this.names = [...names].sort();
    for (const name of this.values.keys()) if (!names.has(name)) this.values.delete(name); // it would be old
    this.number = (this.number + 1) & 0xff;
    if (this.socket?.readyState === WebSocket.OPEN && this.connected) {
      this.socket.send(JSON.stringify({ subscribe: this.names, number: this.number }));
    }
  }

  private frame(data: ArrayBuffer): void {
    const view = new DataView(data);
    const n = view.getUint16(2, true);
    if (view.getUint8(0) !== VERSION || view.getUint8(1) !== this.number) return;
    if (n !== this.names.length || data.byteLength !== HEAD_BYTES + 12 * n) return;
    this.stamp = view.getUint32(4, true);
    this.tick = view.getFloat64(8, true);
    this.tickAgeMs = view.getFloat64(16, true) * 1000;
    const values = new Float64Array(data, HEAD_BYTES, n);
    const status = new Uint32Array(data, HEAD_BYTES + 8 * n, n);
    for (let i = 0; i < n; i++) {
      const name = this.names[i]!;
      const old = this.values.get(name);
      if (old) [old.value, old.status] = [values[i]!, status[i]!];
      else this.values.set(name, { value: values[i]!, status: status[i]! });
    }
    this.lastFrame = performance.now();
    this.tell(this.frameListeners);
  }

  private tell(listeners: Set<Listener>): void {
    for (const listener of [...listeners]) listener();
  }
}

export const live = new Live();
