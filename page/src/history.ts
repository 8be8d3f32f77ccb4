/** What was seen of the signals that are plotted. */

import { live } from "./net";

/** Ten minutes at 60 frames a second. */
const MOST_POINTS = 36_000;
const HOLE_S = 1;

/** What was seen of a signal, oldest first; shared by all plots. */
export class History {
  readonly times: number[] = [];
  /** UTC of each time [ms since 1970]; NaN: not known. */
  readonly utcMs: number[] = [];
  readonly series = new Map<string, (number | null)[]>();

  add(t: number): void {
    if (this.times.length && t < this.times[this.times.length - 1]!) this.clear();
    const last = this.times[this.times.length - 1];
    if (last === t) return;
    if (last !== undefined && t - last > HOLE_S * Math.max(1, live.slow.board.speed ?? 1)) {
      this.times.push((last + t) / 2); // nothing was seen: no line is drawn there
      this.utcMs.push(NaN);
      for (const values of this.series.values()) values.push(null);
    }
    this.times.push(t);
    this.utcMs.push(live.utcMs);
    for (const [name, values] of this.series) {
      const value = live.value(name);
      values.push(Number.isFinite(value) ? value : null);
    }
    const old = this.times.length - MOST_POINTS;
    if (old > 300) for (const column of [this.times, this.utcMs, ...this.series.values()]) column.splice(0, old);
  }

  follow(name: string): void {
    if (!this.series.has(name)) this.series.set(name, this.times.map(() => null));
  }

  /** Forget what is plotted no more. */
  keepOnly(names: Set<string>): void {
    for (const name of this.series.keys()) if (!names.has(name)) this.series.delete(name);
  }

  /** Take in what the ring held: older times in front, and what a new signal was meanwhile. */
  merge(times: number[], series: Record<string, (number | null)[]>): void {
    const first = this.times[0] ?? Infinity;
    const [knownT, knownMs] = this.times.length ? [first, this.utcMs[0]!] : [times[times.length - 1] ?? 0, live.utcMs];
    const msPerS = 1000 / (live.slow.board.speed || 1);
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
    this.utcMs.unshift(...older.map((t) => knownMs - (knownT - t) * msPerS));
  }

  /** Where a time stands: the last place that is not later; the first one for an earlier time. */
  placeOf(t: number): number {
    let [low, high] = [0, Math.max(0, this.times.length - 1)];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle]! <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** UTC of a simulated time [ms since 1970]; NaN: not known. */
  utcOf(t: number): number {
    const { times } = this;
    const isSeen = times.length > 0 && t >= times[0]! && t <= times[times.length - 1]!;
    return isSeen ? this.utcMs[this.placeOf(t)]! : NaN;
  }

  clear(): void {
    for (const column of [this.times, this.utcMs, ...this.series.values()]) column.length = 0;
  }
}
