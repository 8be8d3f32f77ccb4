/** What is plotted, and what was seen of it: it goes on while another view is open. */

import { History } from "./history";
import { get, live, type Signal } from "./net";
import { recall, store } from "./ui";

export const MOST_LINES = 6;
export const SPANS_S = [5, 10, 20, 60, 120, 600];
const KEPT = "watch";
const MOST_ASKED = 24;
const START: string[][] = [
  ["wheel.fl.demand_rpm", "wheel.fl.speed_rpm"],
  ["velocity.linear_m_s", "velocity.angular_rad_s"],
];

interface Kept {
  groups: string[][];
  over: boolean[];
  windowS: number;
}

class Plotted {
  readonly history = new History();
  groups: string[][] = [];
  /** Groups whose first signal is the x axis of the others. */
  readonly over = new Set<string[]>();
  windowS = 20;
  /** A simulated time that the plots show when they open. */
  goTo: number | null = null;
  /** Called when what was seen before has come. */
  onMerged = (): void => {};
  private asked = new Set<string>();
  private fresh = new Set<string>();

  /** Take the plots up as they were when the page was last open in this browser. */
  begin(signals: Signal[]): void {
    const known = new Set(signals.map((signal) => signal.name));
    const { groups, over, windowS } = recall<Kept>(KEPT);
    const sound = Array.isArray(groups) ? groups : START;
    for (const [i, group] of sound.entries()) {
      const names = [group].flat().filter((name) => known.has(name)).slice(0, MOST_LINES);
      if (!names.length) continue;
      this.groups.push(names);
      if (Array.isArray(over) && over[i]) this.over.add(names);
    }
    if (SPANS_S.includes(windowS!)) this.windowS = windowS!;
    this.changed();
    live.onFrame(() => {
      const t = live.value("sim.time_s");
      if (Number.isFinite(t)) this.history.add(t);
      if (this.history.times.length && this.fresh.size) this.ask(); // what the ring holds joins what comes in
    });
  }

  save(): void {
    store(KEPT, { groups: this.groups, over: this.groups.map((group) => this.over.has(group)), windowS: this.windowS } satisfies Kept);
  }

  /** Follow what the groups name now. */
  changed(): void {
    const names = [...new Set(this.groups.flat())];
    live.want("plotted", names.length ? ["sim.time_s", ...names] : []);
    this.save();
    this.history.keepOnly(new Set(names));
    for (const name of this.asked) if (!names.includes(name)) this.asked.delete(name);
    for (const name of names) this.history.follow(name);
    for (const name of names) if (!this.asked.has(name)) this.fresh.add(name);
  }

  private ask(): void {
    const names = [...this.fresh].slice(0, MOST_ASKED);
    this.fresh.clear();
    for (const name of names) this.asked.add(name);
    const query = names.map((name) => `name=${encodeURIComponent(name)}`).join("&");
    get<{ times: number[]; series: Record<string, (number | null)[]> }>(`history?${query}`)
      .then(({ times, series }) => {
        this.history.merge(times, series);
        this.onMerged();
      })
      .catch(() => {}); // the plot begins with what comes in
  }
}

export const plotted = new Plotted();
