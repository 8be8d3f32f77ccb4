/** A stick for a thumb, also for keys when it has the focus. */

import { h } from "./ui";

export interface Stick {
  element: HTMLElement;
  /** Whether a pointer holds it. */
  held(): boolean;
  /** Let go of the pointer: it drives again when it is pressed again. */
  release(): void;
  show(x: number, y: number): void;
}

/** `move` is told x (right positive) and y (forward positive), both -1 .. 1; zero when let go. */
export function makeStick(move: (x: number, y: number) => void): Stick {
  const knob = h("div", { class: "knob" });
  const base = h(
    "div",
    { class: "stick", role: "application", tabindex: "0", "aria-label": "Joystick: drag, or hold the arrow keys" },
    h("div", { class: "cross", "aria-hidden": "true" }),
    knob,
  );
  let pointer: number | null = null;

  function show(x: number, y: number): void {
    knob.style.transform = `translate(${(x * 62).toFixed(1)}%, ${(-y * 62).toFixed(1)}%)`;
  }

  function follow(event: PointerEvent): void {
    const box = base.getBoundingClientRect();
    const radius = box.width / 2;
    let x = (event.clientX - box.left - radius) / (radius * 0.7);
    let y = -(event.clientY - box.top - radius) / (radius * 0.7);
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    if (Math.abs(x) < 0.06) x = 0;
    if (Math.abs(y) < 0.06) y = 0;
    move(x, y);
  }

  function letGo(event: PointerEvent): void {
    if (event.pointerId !== pointer) return;
    pointer = null;
    move(0, 0);
  }

  base.addEventListener("pointerdown", (event) => {
    if (pointer !== null) return;
    pointer = event.pointerId;
    base.setPointerCapture(pointer);
    follow(event);
  });
  base.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pointer) return;
    if (event.buttons) follow(event);
    else letGo(event); // its release went elsewhere
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) base.addEventListener(name, letGo);
  return {
    element: base,
    held: () => pointer !== null,
    release: () => void (pointer = null),
    show,
  };
}
