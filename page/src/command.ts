/** Hold to drive: what is held is renewed many times a second, what is let go is zero at once. */

import { live } from "./net";

const EVERY_MS = 50;

export type Held =
  | { mode: "twist"; linear: number; turn: number }
  | { mode: "wheels"; rpm: [number, number, number, number] };

function isZero(held: Held): boolean {
  return held.mode === "twist" ? !held.linear && !held.turn : held.rpm.every((rpm) => !rpm);
}

export class Commander {
  private held: Held | null = null;
  private timer = 0;

  /** Hold a command; zero lets go. */
  hold(next: Held): void {
    const was = this.held;
    this.held = isZero(next) ? null : next;
    if (this.held || was) live.drive(next);
    if (this.held && !this.timer) this.timer = window.setInterval(() => this.renew(), EVERY_MS);
    if (!this.held) this.end();
  }

  /** Everything to zero, held or not. */
  stop(): void {
    this.held = null;
    this.end();
    live.drive({ mode: "twist", linear: 0, turn: 0 });
  }

  get active(): boolean {
    return this.held !== null;
  }

  private renew(): void {
    if (this.held) live.drive(this.held);
  }

  private end(): void {
    window.clearInterval(this.timer);
    this.timer = 0;
  }
}
