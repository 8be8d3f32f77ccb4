/**
 * The hands: keys, gamepad, stick and sliders. Whoever drives does so in every view, and stops in every view.
 *
 * A hand that is gone, hidden or frozen renews nothing. After everything was set to zero a hand has to let go
 * before it drives again.
 */

import { Commander, type Hand } from "./command";
import type { Robot } from "./context";
import { joyOf, MAPPINGS, press } from "./gamepad";
import { live } from "./net";
import { recall, store, toast } from "./ui";

const KEYS: Record<string, [number, number]> = {
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
};
const DEAD_ZONE = 0.12;
const PAD_KEY = "hilserver.gamepad";
/** A stick that is held sends no news while nothing trembles; a receiver whose gamepad is lost never does. */
const PAD_SILENT_MS = 5000;

const NO_TEXT = ["range", "number", "checkbox", "radio", "button", "submit", "color", "file"];
const TEXT = `textarea, input${NO_TEXT.map((type) => `:not([type=${type}])`).join("")}`;
const PRESSES = "a, button, summary, select, input[type=checkbox], input[type=radio], input[type=color], input[type=file]";
const OWN_ARROWS = `${TEXT}, select, input[type=number], [data-arrows=own]`;

/** Whether keys and gamepad reach this page: not while it is hidden, or while a report has the focus. */
function isInFront(): boolean {
  return !document.hidden && document.hasFocus() && !(document.activeElement instanceof HTMLIFrameElement);
}

export class Wheel {
  /** Part of the largest speed that a full stick asks for. */
  share = 0.5;
  readonly commander = new Commander();
  /** Called with where the stick stands now. */
  onStick: (x: number, y: number) => void = () => {};
  /** Called when everything is zero: what is still held has to be let go first. */
  onHalt: () => void = () => {};
  private pressed = new Set<string>();
  private pad = { name: "", stamp: NaN, newsMs: 0, isHeld: false, wasAtRest: false, buttons: [] as boolean[] };
  private padMapping = recall<{ mapping: string }>(PAD_KEY).mapping ?? "page";

  constructor(private robot: Robot, private emergencyStop: () => void) {
    window.addEventListener("keydown", (event) => this.down(event), true); // before a dialog or a field has it
    window.addEventListener("keyup", (event) => {
      if (this.pressed.delete(event.key)) this.steer();
    }, true);
    window.addEventListener("blur", () => this.letGo());
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    window.setInterval(() => this.gamepad(), 50);
    this.commander.onGone = () => this.halt();
    live.onSlow(() => {
      const ended = !live.drives || live.slow.board.state === "safe" || live.slow.board.state === "paused";
      if (ended && this.commander.active) this.halt();
    });
  }

  /** Name of what the gamepad's axes and buttons mean; this browser remembers it. */
  get mapping(): string {
    return this.padMapping in MAPPINGS ? this.padMapping : "page";
  }

  set mapping(name: string) {
    this.halt();
    this.padMapping = name;
    store(PAD_KEY, { mapping: name });
  }

  /** Drive by a hand; zero lets go. */
  twist(x: number, y: number, hand: Hand): void {
    if ((x || y) && !live.drives) return void toast("Take control first.");
    this.onStick(x, y);
    this.commander.hold(
      {
        mode: "twist",
        linear: y * this.share * this.robot.max_linear_m_s,
        turn: -x * this.share * this.robot.max_angular_rad_s,
      },
      () => isInFront() && hand(),
    );
  }

  /** Drive single wheels by a hand; zeros let go. */
  wheels(rpm: [number, number, number, number], hand: Hand): void {
    if (rpm.some(Boolean) && !live.drives) return void toast("Take control first.");
    this.commander.hold({ mode: "wheels", rpm }, () => isInFront() && hand());
  }

  /** Everything to zero; what is held acts again when it was let go. */
  halt(): void {
    this.pressed.clear();
    this.pad.isHeld = this.pad.wasAtRest = false;
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
    this.twist(x, y, () => this.pressed.size > 0);
  }

  /**
   * One rule for keys, whatever has the focus:
   *
   * - X stops the robot, except while you type a text;
   * - Esc stops it while you drive, always, and so does space where it neither presses something nor types;
   * - S lets go while you drive, except while you type a text;
   * - arrows drive while you drive, except in a text, a number or a list, which take them until you leave.
   */
  private down(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const types = target.matches(TEXT);
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const stops =
      (key === "x" && !types) || (live.drives && (key === "Escape" || (key === " " && !types && !target.matches(PRESSES))));
    if (stops) {
      event.preventDefault();
      if (!event.repeat) this.emergencyStop();
    } else if (key === "s" && live.drives && !types) {
      event.preventDefault();
      this.halt();
    } else if (key in KEYS) this.arrow(event, target);
  }

  private arrow(event: KeyboardEvent, target: HTMLElement): void {
    const isFields = target.matches(OWN_ARROWS) || (!live.drives && target.matches("input"));
    if (isFields && !this.pressed.size) return;
    if (!live.drives && !document.querySelector("main[data-view='drive']")) return;
    event.preventDefault();
    if (event.repeat || this.pressed.has(event.key)) return;
    if (!live.drives) return void toast("Take control first.");
    this.pressed.add(event.key);
    this.steer();
  }

  private gamepad(): void {
    const state = this.pad;
    const pad = navigator.getGamepads?.().find((each) => each?.connected);
    const mapping = MAPPINGS[this.mapping]!;
    const joy = pad ? joyOf(pad) : { axes: [], buttons: [] };
    if (joy.buttons[mapping.stop] && !state.buttons[mapping.stop]) this.emergencyStop();
    if (isInFront()) press(mapping, joy.buttons, state.buttons);
    state.buttons = joy.buttons;

    const name = pad ? `${pad.index} ${pad.id}` : "";
    const isAnother = name !== state.name;
    if (isAnother || pad?.timestamp !== state.stamp) [state.name, state.stamp, state.newsMs] = [name, pad?.timestamp ?? NaN, performance.now()];
    const isSilent = performance.now() - state.newsMs > PAD_SILENT_MS;
    if (state.isHeld && (isAnother || isSilent || !isInFront())) {
      if (isAnother) toast("The gamepad is gone: the robot stops.", "error");
      else if (isSilent) toast(`No news of the gamepad for ${PAD_SILENT_MS / 1000} s: the robot stops. Let go of the stick to drive on.`, "error");
      return this.halt();
    }

    const dead = (value: number): number => (Math.abs(value) < DEAD_ZONE ? 0 : value);
    const [left, ahead] = mapping.stick(joy);
    const [x, y] = [-dead(left) || 0, dead(ahead)];
    const isAtRest = !x && !y;
    if (isAtRest || isAnother || !live.drives) state.wasAtRest = isAtRest;
    if (!live.drives || !(state.isHeld || (x && state.wasAtRest) || (y && state.wasAtRest))) return;
    state.isHeld = !isAtRest;
    this.twist(x, y, () => this.pad.isHeld);
  }
}
