/** Which robots are shown, and where: one truth for the picture in space and the plan. */

import { WHEELS, type Context } from "./context";
import { live } from "./net";
import { quality } from "./ui";

export const CORNERS = ["fl", "fr", "rl", "rr"] as const;
export const FAR_M = 4.99;
export const TRAIL_STEP_M = 0.015;

export interface Pose {
  x: number;
  y: number;
  yaw: number;
  z: number;
  roll: number;
  pitch: number;
}

const AXES = ["x_m", "y_m", "yaw_rad"];
const PLANAR = AXES.map((axis) => `pose.${axis}`);
const BODY = [...AXES, "z_m", "roll_rad", "pitch_rad"].map((axis) => `mech.${axis}`);

const ESTIMATE = AXES.map((axis) => `estimate.${axis}`);
/** Standard deviations in x and y, and their covariance. */
const SPREAD = ["estimate.x_m_sd", "estimate.y_m_sd", "estimate.x_y_cov"];
/** Of the chi-squared distribution with two degrees of freedom: 95 % lie within. */
const CHI_SQUARED_95 = 5.991;

export interface Ghost {
  name: string;
  colour: string;
  signals: string[];
  spread?: string[];
}

/** Where another model, or the real robot, is. The body is the robot itself where there is one: walls stop it. */
export function ghosts(context: Context): Ghost[] {
  return [
    ...(context.robot.has_body ? [{ name: "Planar model", colour: "#0f8a6d", signals: PLANAR }] : []),
    { name: "Measured", colour: "#d97706", signals: AXES.map((axis) => `measured.pose.${axis}`) },
    { name: "Measured tag", colour: "#b4308f", signals: AXES.map((axis) => `measured.nav.${axis}`) },
    { name: "Estimate", colour: "#5b4bc4", signals: ESTIMATE, spread: SPREAD },
  ];
}

function read(signals: string[], height_m: number): Pose | null {
  const values = signals.map((name) => {
    const reading = live.get(name);
    return reading && quality(reading.status) !== "bad" && quality(reading.status) !== "uncertain" ? reading.value : NaN;
  });
  const [x, y, yaw, z, roll, pitch] = values;
  if (!Number.isFinite(x! + y! + yaw!)) return null;
  return { x: x!, y: y!, yaw: yaw!, z: Number.isFinite(z) ? z! - height_m : 0, roll: roll || 0, pitch: pitch || 0 };
}

/** Where the robot is: its body, where one stands in the hall. */
export function robotPose(context: Context): Pose {
  const body = context.robot.has_body ? read(BODY, context.robot.mass_height_m) : null;
  return body ?? planarPose();
}

/** From where the range finders look. */
export function sensorPose(context: Context): Pose {
  return context.robot.body_senses ? robotPose(context) : planarPose();
}

function planarPose(): Pose {
  const [x, y, yaw] = PLANAR.map((name) => live.value(name) || 0);
  return { x: x!, y: y!, yaw: yaw!, z: 0, roll: 0, pitch: 0 };
}

/** Where a ghost is; null where nobody says so. */
export function ghostPose(ghost: Ghost): Pose | null {
  const pose = read(ghost.signals, 0);
  return pose && (pose.x || pose.y || pose.yaw) ? pose : null;
}

export interface Ellipse {
  long: number;
  short: number;
  turn: number;
}

/** Half axes [m] and direction [rad] of the ellipse in which a ghost is with 95 %; null where nobody says so. */
export function ellipse95(ghost: Ghost): Ellipse | null {
  const [sx, sy, xy] = (ghost.spread ?? []).map((name) => live.value(name));
  if (!Number.isFinite(sx! + sy! + xy!) || sx! > 1e3) return null;
  const [xx, yy] = [sx! * sx!, sy! * sy!];
  const [mean, apart] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy!)];
  const axis = (variance: number): number => Math.sqrt(CHI_SQUARED_95 * Math.max(variance, 0));
  return { long: axis(mean + apart), short: axis(mean - apart), turn: 0.5 * Math.atan2(2 * xy!, xx - yy) };
}

/** Beginning and end of every range finder's ray that meets something, on the floor. */
export function rays(context: Context): ([number, number, number, number] | null)[] {
  const { x, y, yaw } = sensorPose(context);
  const { tof_x_m: mx, tof_y_m: my } = context.robot;
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  return CORNERS.map((name) => {
    const range = live.value(`tof.${name}_m`);
    if (!(range < FAR_M)) return null;
    const forward = name[0] === "f" ? 1 : -1;
    const [px, py] = [forward * mx, name[1] === "l" ? my : -my];
    const far = px + forward * range;
    return [x + px * cos - py * sin, y + px * sin + py * cos, x + far * cos - py * sin, y + far * sin + py * cos];
  });
}

export function lampOf(place: string): string[] {
  return ["red", "green", "blue"].map((colour) => `lights.${place}.${colour}`);
}

/** Signals that the picture is made of. */
export function pictureSignals(context: Context): string[] {
  const names = [...PLANAR, ...BODY, ...ghosts(context).flatMap(({ signals, spread = [] }) => [...signals, ...spread])];
  for (const wheel of WHEELS) names.push(`wheel.${wheel}.angle_rad`);
  for (const corner of CORNERS) names.push(`tof.${corner}_m`, ...lampOf(corner));
  const known = new Set(context.signals.map((signal) => signal.name));
  return [...new Set(names)].filter((name) => known.has(name));
}

export interface Hall {
  x: number;
  y: number;
  size: number;
  left: number;
  right: number;
  bottom: number;
  top: number;
}

/** Length of the robot [m], its larger side. */
export function robotSize({ robot }: Context): number {
  return Math.max((robot.wheelbase_m ?? 0) + 2 * robot.wheel_radius_m, robot.track_m);
}

/** What is to be seen: the hall, or where there is none a field as large as the robot needs. */
export function hallOf(context: Context): Hall {
  const { walls } = context;
  const least = Math.max(6, 10 * robotSize(context));
  if (!walls.length) return { x: 0, y: 0, size: least, left: -least / 2, right: least / 2, bottom: -least / 2, top: least / 2 };
  const xs = walls.flatMap((wall) => [wall[0], wall[2]]);
  const ys = walls.flatMap((wall) => [wall[1], wall[3]]);
  const [left, right, bottom, top] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  return { x: (left + right) / 2, y: (bottom + top) / 2, size: Math.max(right - left, top - bottom, 1), left, right, bottom, top };
}

/** Distance of the lines on the floor [m]: 1, 2, 5 times a power of ten. */
export function gridStep(size: number): number {
  const rough = size / 10;
  const power = 10 ** Math.floor(Math.log10(rough));
  return power * ([1, 2, 5].find((step) => step * power >= rough * 0.8) ?? 10);
}
