/** Hands on a plot: one finger draws the time along, two stretch it; up and down still scrolls the page. */

import type uPlot from "uplot";

const SHORTEST_S = 0.05;
const MOVED_PX = 6;

interface Finger {
  x: number;
  /** The time that it holds [s]. */
  t: number;
}

/**
 * Let fingers move the time axis of a chart.
 *
 * @param grasp called with a time once finger or mouse have moved there, before the axis does
 * @param show shows a stretch of time [s]; what the mouse marks, the chart shows itself
 */
export function fingers(chart: uPlot, grasp: (t: number) => void, show: (min: number, max: number) => void): void {
  const over = chart.over;
  over.style.touchAction = "pan-y";
  const held = new Map<number, Finger>();
  let moved = false;

  const place = (event: PointerEvent): number => event.clientX - over.getBoundingClientRect().left;
  /** Each finger holds the time that is under it now. */
  function hold(): void {
    for (const finger of held.values()) finger.t = chart.posToVal(finger.x, "x");
  }

  over.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse") held.clear(); // it may have been let go elsewhere
    if (held.size === 2) return;
    if (!held.size) moved = false;
    held.set(event.pointerId, { x: place(event), t: 0 });
    hold();
  });
  over.addEventListener("pointermove", (event) => {
    const finger = held.get(event.pointerId);
    if (!finger || !event.buttons || (!moved && Math.abs(place(event) - finger.x) < MOVED_PX)) return;
    if (!moved) grasp(finger.t);
    moved = true;
    if (event.pointerType === "mouse") return;
    finger.x = place(event);
    const [one, two] = [...held.values()] as [Finger, Finger?];
    const { min = 0, max = 0 } = chart.scales["x"]!;
    const apart = two ? two.x - one.x : 0;
    let perPixel = (max - min) / over.clientWidth;
    if (two && Math.abs(apart) > MOVED_PX) perPixel = Math.max((two.t - one.t) / apart, SHORTEST_S / over.clientWidth);
    const first = one.t - one.x * perPixel;
    show(first, first + over.clientWidth * perPixel);
  });
  for (const name of ["pointerup", "pointercancel"] as const)
    over.addEventListener(name, (event) => {
      held.delete(event.pointerId);
      hold();
    });
}
