/** What has happened, as far as this page has seen it; what is serious stays until somebody has read it. */

import { live, type Happening } from "./net";
import { alarm, recall, store } from "./ui";

interface Seen {
  untilMs: number;
}

const MOST = 500;
const ALARMING = 700;
/** Two readings of the same clock differ by less [ms]. */
const SAME_MS = 500;
const KEPT = "seen";
const kept = new Map<string, Happening>();

/** Everything that is known, oldest first. */
export function happenings(): Happening[] {
  return [...kept.values()];
}

/** What happened next to a simulated time, if anything did within so many seconds. */
export function happenedAt(t: number, withinS: number): Happening | undefined {
  const away = (event: Happening): number => Math.abs((event.simulated_s ?? Infinity) - t);
  return happenings().filter((event) => away(event) < withinS).sort((one, other) => away(one) - away(other))[0];
}

function look(): void {
  for (const event of [...(live.slow.board.events ?? [])].reverse()) {
    const key = `${event.monotonic_s} ${event.source}`;
    if (event.kind === "overrun" || kept.has(key)) continue;
    kept.set(key, event);
    if (event.kind === "state" && event.severity >= ALARMING) raise(event);
  }
  for (const key of kept.keys()) {
    if (kept.size <= MOST) break;
    kept.delete(key);
  }
}

/**
 * A recording that has died, a task that has failed: it is shown until it was read, after a reload as well, but not to
 * a browser that comes for the first time.
 */
function raise(event: Happening): void {
  const at = live.utcMsOf(event);
  if (at < seenUntilMs() + SAME_MS) return;
  alarm(event.source, `${event.source.charAt(0).toUpperCase()}${event.source.slice(1)}: ${event.text}`, {
    onSeen: () => store(KEPT, { untilMs: Math.max(at, seenUntilMs()) } satisfies Seen),
  });
}

function seenUntilMs(): number {
  const { untilMs } = recall<Seen>(KEPT);
  if (untilMs === undefined) store(KEPT, { untilMs: live.utcMs } satisfies Seen);
  return untilMs ?? live.utcMs;
}

export function watchHappenings(): void {
  live.onSlow(() => {
    if (live.slow.board.events) seenUntilMs();
    look();
  });
}
