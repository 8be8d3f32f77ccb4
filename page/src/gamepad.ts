/**
 * What a gamepad's axes and buttons mean, by name: the page's own, and those of both generations of EduArt's stack.
 *
 * EduArt's are numbered as ROS's joy node numbers a PlayStation 4 or 5 controller. A browser counts differently, so a
 * pad is first translated into a Joy.
 */

import { call, live } from "./net";
import { toast } from "./ui";

/** As in sensor_msgs/Joy: left and up are positive; a trigger is 1 at rest and -1 when pressed. */
interface Joy {
  axes: number[];
  buttons: boolean[];
}

interface Mapping {
  title: string;
  /** The button of the emergency stop, and what is written on it. */
  stop: number;
  stopName: string;
  /** To the left and ahead, from -1 to 1. */
  stick(joy: Joy): [number, number];
  lights: Record<number, Light>;
  enable?: number;
}

type Light = [pattern: number, red: number, green: number, blue: number];

const AMBER = [255, 0x88, 0] as const;
const FLASH_ALL: Light = [3, ...AMBER];
const FLASH_LEFT: Light = [4, ...AMBER];
const FLASH_RIGHT: Light = [5, ...AMBER];
const ROTATION: Light = [7, 0, 0, 255];
const RUNNING: Light = [8, 255, 0, 0];

export const MAPPINGS: Record<string, Mapping> = {
  page: {
    title: "left stick",
    stop: 1,
    stopName: "B or circle",
    stick: ({ axes: [left, ahead] }) => [left ?? 0, ahead ?? 0],
    lights: {},
  },
  "iotbot-ros2": {
    title: "EduArt iotbot-ros2",
    stop: 1,
    stopName: "circle or B",
    stick: ({ axes }) => [axes[0] ?? 0, axes[4] ?? 0],
    lights: { 3: [1, 0, 255, 0], 4: FLASH_LEFT, 5: FLASH_RIGHT, 8: ROTATION, 9: RUNNING, 13: FLASH_ALL },
    enable: 10,
  },
  "joy_extended": {
    title: "EduArt joy_extended",
    stop: 2, // circle is the warning light
    stopName: "triangle or Y",
    stick({ axes }) {
      const factor = ((axes[5] ?? 1) + 1) / 2;
      return [(axes[3] ?? 0) * factor, (axes[1] ?? 0) * factor];
    },
    lights: { 0: [2, 255, 255, 255], 1: FLASH_ALL, 4: FLASH_LEFT, 5: FLASH_RIGHT, 8: ROTATION, 9: RUNNING },
    enable: 10,
  },
};

/** Places of Joy's buttons among those of a browser's standard gamepad: cross, circle, triangle, square, ... */
const STANDARD_BUTTONS = [0, 1, 3, 2, 4, 5, 6, 7, 8, 9, 16, 10, 11, 17];

export function joyOf(pad: Gamepad): Joy {
  const pressed = (index: number): boolean => pad.buttons?.[index]?.pressed ?? false;
  const raw = pad.axes.map((value) => -value || 0); // a browser counts right and down as positive
  if (pad.mapping !== "standard") return { axes: raw, buttons: (pad.buttons ?? []).map((_, index) => pressed(index)) };
  const trigger = (index: number): number => 1 - 2 * (pad.buttons[index]?.value ?? 0);
  const [x = 0, y = 0, rightX = 0, rightY = 0] = raw;
  return { axes: [x, y, trigger(6), rightX, rightY, trigger(7)], buttons: STANDARD_BUTTONS.map(pressed) };
}

/** What newly pressed buttons switch: the lights, and the drive. */
export function press(mapping: Mapping, now: boolean[], before: boolean[]): void {
  if (!live.drives) return;
  const isNew = (button: number): boolean => (now[button] ?? false) && !(before[button] ?? false);
  for (const [button, light] of Object.entries(mapping.lights)) if (isNew(Number(button))) void shine(light);
  if (mapping.enable !== undefined && isNew(mapping.enable)) void write("drive.enable", true);
}

async function shine([pattern, red, green, blue]: Light): Promise<void> {
  await write("lights.red", red);
  await write("lights.green", green);
  await write("lights.blue", blue);
  await write("lights.command", pattern);
}

async function write(name: string, value: number | boolean): Promise<void> {
  await call("write", name, value).catch((error: Error) => toast(error.message, "error"));
}
