/** Overruns: red is for what goes wrong now; what once went wrong stays in the figures. */

import type { Slice } from "./net";

const RECENT_MS = 10_000;
const seen = new Map<string, { count: number; grewMs: number }>();

/** Whether a count has grown in the last seconds. */
export function grewLately(name: string, count: number): boolean {
  const now = performance.now();
  const before = seen.get(name);
  const grewMs = before && count > before.count ? now : (before?.grewMs ?? -Infinity);
  seen.set(name, { count, grewMs });
  return now - grewMs < RECENT_MS;
}

export const OVERRUNS = ["late_wakes", "long_runs", "missed_ticks"] as const;

/** Why a slice was late in the last seconds: "3 long runs"; empty if it was not. */
export function lateness(name: string, slice: Slice): string {
  return OVERRUNS.filter((key) => grewLately(`late ${name} ${key}`, Number(slice[key] ?? 0)))
    .map((key) => key.replace("_", " "))
    .join(", ");
}
