/** Keys and gamepad: whoever drives does so in every view, and stops in every view. */

import { Commander } from "./command";
import type { Robot } from "./context";
import { live } from "./net";
import { toast } from "./ui";

const KEYS: Record<string, [number, number]> = {
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
};
const STOPS = new Set(["x", "X"]);
const DRIVER_STOPS = new Set([" ", "Escape"]); // who only watches scrolls with them
const DEAD_ZONE = 0.12;
const STOP_BUTTON = 1; // B, or the circle
const OWN_KEYS = "input, textarea, select";

export class Wheel {
  /** Part of the largest speed that a full stick asks for. */
  share = 0.5;
  readonly commander = new Commander();
  /** Called with where the stick stands now. */
  onStick: (x: number, y: number) => void = () => {};
  /** Called when everything is zero. */
  onHalt: () => void = () => {};
  private pressed = new Set<string>();
  private padHeld = false;
  private padStops = false;

  constructor(private robot: Robot, private emergencyStop: () => void) {
    window.addEventListener("keydown", (event) => this.down(event));
    window.addEventListener("keyup", (event) => {
      if (this.pressed.delete(event.key)) this.steer();
    });
    window.addEventListener("blur", () => this.letGo());
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    window.setInterval(() => this.gamepad(), 50);
    live.onSlow(() => {
      if (!live.drives && this.commander.active) this.halt();
    });
  }

  twist(x: number, y: number): void {
    if ((x || y) && !live.drives) return void toast("Take control first.");
    this.onStick(x, y);
    this.commander.hold({
      mode: "twist",
      linear: y * this.share * this.robot.max_linear_m_s,
      turn: -x * this.share * this.robot.max_angular_rad_s,
    });
  }

  /** Everything to zero; a key that is held acts again when it is pressed again. */
  halt(): void {
    this.pressed.clear();
    this.onStick(0, 0);
    this.onHalt();
    this.commander.stop();
  }

  letGo(): void {
    if (this.pressed.size || this.commander.active) this.halt();
  }

  private steer(): void {
    let [x, y] = [0, 0];
    for (const key of this.pressed) {
      x += KEYS[key]![0];
      y += KEYS[key]![1];
    }
    this.twist(x, y);
  }

  private down(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.matches(OWN_KEYS)) return;
    if (STOPS.has(event.key) || (live.drives && DRIVER_STOPS.has(event.key))) {
      if (event.key === " " && target.matches("a, button, summary")) return; // presses that
      if (event.key === "Escape" && target.closest("dialog")) return; // closes that
      event.preventDefault();
      if (!event.repeat) this.emergencyStop();
    } else if (event.key === "s" || event.key === "S") this.halt();
    else if (event.key in KEYS && (live.drives || document.querySelector("main[data-view='drive']"))) {
      event.preventDefault();
      if (event.repeat || this.pressed.has(event.key)) return;
      if (!live.drives) return void toast("Take control first.");
      this.pressed.add(event.key);
      this.steer();
    }
  }

  private gamepad(): void {
    const pad = navigator.getGamepads?.().find((each) => each?.connected);
    if (!pad) return;
    const stops = pad.buttons?.[STOP_BUTTON]?.pressed ?? false;
    if (stops && !this.padStops) this.emergencyStop();
    this.padStops = stops;
    if (!live.drives) return;
    const dead = (value: number | undefined): number => (Math.abs(value ?? 0) < DEAD_ZONE ? 0 : value!);
    const [x, y] = [dead(pad.axes[0]), -dead(pad.axes[1])];
    if (x || y || this.padHeld) this.twist(x, y);
    this.padHeld = !!(x || y);
  }
}
