/** Hold to drive: the hand that holds a command renews it many times a second, and nobody else does. */

import { live } from "./net";

const EVERY_MS = 50;

export type Held =
  | { mode: "twist"; linear: number; turn: number }
  | { mode: "wheels"; rpm: [number, number, number, number] };

const ZERO: Held = { mode: "twist", linear: 0, turn: 0 };

/** Whether a hand still holds what it held: asked before every renewal. */
export type Hand = () => boolean;

function isZero(held: Held): boolean {
  return held.mode === "twist" ? !held.linear && !held.turn : held.rpm.every((rpm) => !rpm);
}

export class Commander {
  /** Called when the hand that held a command is gone. */
  onGone: () => void = () => {};
  private held: Held | null = null;
  private hand: Hand = () => false;
  private timer = 0;

  /** Hold a command as long as `hand` does; zero lets go. */
  hold(next: Held, hand: Hand): void {
    const was = this.held;
    this.held = isZero(next) ? null : next;
    this.hand = hand;
    if (this.held && !was) live.drive(ZERO); // after a Reset the daemon waits for a hand at rest
    if (this.held || was) live.drive(next);
    if (this.held && !this.timer) this.timer = window.setInterval(() => this.renew(), EVERY_MS);
    if (!this.held) this.end();
  }

  /** Everything to zero, held or not. */
  stop(): void {
    this.held = null;
    this.end();
    if (live.drives) live.drive(ZERO);
  }

  get active(): boolean {
    return this.held !== null;
  }

  private renew(): void {
    if (this.held && this.hand()) live.drive(this.held);
    else this.onGone();
  }

  private end(): void {
    window.clearInterval(this.timer);
    this.timer = 0;
  }
}
