/** What was seen of the signals that are plotted. */

import { live } from "./net";

const LONGEST_S = 120;
const HOLE_S = 1;

/** What was seen of a signal, oldest first; shared by all plots. */
export class History {
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
