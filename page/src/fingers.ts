/**
 * Hands on a plot: one finger draws the time along, two stretch it, and so does the wheel; up and down of one finger
 * still scrolls the page.
 */

import type uPlot from "uplot";

const SHORTEST_S = 0.05;
const MOVED_PX = 6;
/** A notch of a wheel, 100 pixels, zooms by a sixth; two fingers on a touch pad send small steps as a wheel with Ctrl. */
const WHEEL_PER_PX = 0.0015;
const PINCH_PER_PX = 0.01;
const LINE_PX = 33;

interface Finger {
  x: number;
  /** The time that it holds [s]. */
  t: number;
}

export interface Hands {
  /** Called with a time once finger, wheel or mouse have moved there, before the axis does. */
  grasp(t: number): void;
  /** Show a stretch of time [s]; what the mouse marks, the chart tells itself. */
  show(min: number, max: number): void;
}

/** Let fingers and wheel move the time axis of a chart. */
export function fingers(chart: uPlot, hands: Hands): void {
  const over = chart.over;
  over.style.touchAction = "pan-y";
  const held = new Map<number, Finger>();
  let moved = false;

  const place = (event: MouseEvent): number => event.clientX - over.getBoundingClientRect().left;
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
    if (!moved) hands.grasp(finger.t);
    moved = true;
    if (event.pointerType === "mouse") return;
    finger.x = place(event);
    const [one, two] = [...held.values()] as [Finger, Finger?];
    const { min = 0, max = 0 } = chart.scales["x"]!;
    const apart = two ? two.x - one.x : 0;
    let perPixel = (max - min) / over.clientWidth;
    if (two && Math.abs(apart) > MOVED_PX) perPixel = Math.max((two.t - one.t) / apart, SHORTEST_S / over.clientWidth);
    const first = one.t - one.x * perPixel;
    hands.show(first, first + over.clientWidth * perPixel);
  });
  for (const name of ["pointerup", "pointercancel"] as const)
    over.addEventListener(name, (event) => {
      held.delete(event.pointerId);
      hold();
    });

  over.addEventListener("wheel", (event) => {
    event.preventDefault();
    const t = chart.posToVal(place(event), "x");
    const { min = 0, max = 0 } = chart.scales["x"]!;
    const px = (delta: number): number => (event.deltaMode ? delta * LINE_PX : delta);
    hands.grasp(t);
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      const by = (px(event.deltaX || event.deltaY) / over.clientWidth) * (max - min);
      return hands.show(min + by, max + by);
    }
    const factor = Math.max(Math.exp(px(event.deltaY) * (event.ctrlKey ? PINCH_PER_PX : WHEEL_PER_PX)), SHORTEST_S / (max - min));
    hands.show(t - (t - min) * factor, t + (max - t) * factor);
  });
}
