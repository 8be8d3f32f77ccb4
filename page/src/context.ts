/** What does not change while the page is open, and what a view looks like from outside. */

import type { Session, Signal } from "./net";
import type { Wheel } from "./wheel";

export interface Robot {
  wheel_radius_m: number;
  wheelbase_m: number | null;
  track_m: number;
  max_rpm: number;
  max_linear_m_s: number;
  max_angular_rad_s: number;
  tof_x_m: number;
  tof_y_m: number;
  tof_field_rad: number;
  /** Of the body's centre of mass, standing. */
  mass_height_m: number;
  /** Whether a body stands in the hall, and whether its sensors are the robot's. */
  has_body: boolean;
  body_senses: boolean;
}

/** A kind of fault: what it does, which numbers it needs and may have, and on what it acts. */
export interface FaultForm {
  name: string;
  text: string;
  needs: string[];
  takes: string[];
  on: string[];
}

export interface Context {
  session: Session;
  signals: Signal[];
  robot: Robot;
  walls: [number, number, number, number][];
  faults: FaultForm[];
  wheel: Wheel;
}

export interface View {
  element: HTMLElement;
  /** Called once when the view goes. */
  close(): void;
}

export const WHEELS = ["fl", "rl", "fr", "rr"] as const;

export function may(context: Context, method: string): boolean {
  return context.session.methods.includes(method);
}
