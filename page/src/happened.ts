/** What has happened, as far as this page has seen it; what is serious stays until somebody has read it. */

import { live, type Happening } from "./net";
import { alarm, recall, store } from "./ui";

const MOST = 500;
const ALARMING = 700;
/** Two readings of the same clock differ by less [ms]. */
const SAME_MS = 500;
const kept = new Map<string, Happening>();

/** Everything that is known, oldest first. */
export function happenings(): Happening[] {
  return [...kept.values()];
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

/** A recording that has died, a task that has failed: seen once, it is not shown again, not even after a reload. */
function raise(event: Happening): void {
  const at = live.utcMsOf(event);
  if (at < (recall<{ untilMs: number }>("seen").untilMs ?? 0) + SAME_MS) return;
  alarm(event.source, `${event.source.charAt(0).toUpperCase()}${event.source.slice(1)}: ${event.text}`, {
    onSeen: () => store("seen", { untilMs: Math.max(at, recall<{ untilMs: number }>("seen").untilMs ?? 0) }),
  });
}

export function watchHappenings(): void {
  live.onSlow(look);
}
