/** Who drives, in words, and asking before somebody who drives is disturbed. */

import { WHEELS } from "./context";
import { live } from "./net";
import { ask } from "./ui";

const NAMES: Record<string, string> = {
  peer: "the controller", opcua: "an OPC UA client", page: "another browser", ros2: "a ROS 2 node",
  shield: "the shield's computer", foxglove: "Foxglove", scenario: "a scenario", teleop: "the terminal",
};
export const SETPOINTS = [WHEELS.map((name) => `wheel.${name}.setpoint_rpm`), ["twist.linear_m_s", "twist.angular_rad_s", "twist.lateral_m_s"]];

/** Who has control; empty: nobody. */
export function driver(): string {
  const { board, driver: seat } = live.slow;
  if (live.drives) return "you";
  if (!board.owner || board.owner === "nobody" || board.owner === "none") return "";
  if (board.owner === "page") return seat === null ? "" : NAMES["page"]!;
  if (board.owner === "opcua" && !board.opcua_wrote) return isCommanded() ? "an OPC UA client that has left" : ""; // it is whoever comes first
  return NAMES[board.owner] ?? board.owner;
}

function isCommanded(): boolean {
  return (SETPOINTS[live.value("control.mode")] ?? []).some((name) => live.value(name));
}

/** Whether somebody loses something when we take control: another browser, a controller, a moving robot. */
export function isBusy(): boolean {
  const { board, driver: seat } = live.slow;
  if (board.owner === "page") return seat !== null;
  if (board.owner === "peer" && Object.values(board.peers ?? {}).some((peer) => peer["connected"])) return true;
  return isCommanded();
}

export function capital(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Do something that others may feel; asks first while somebody else drives. */
export async function considerate(what: string, act: () => Promise<unknown>): Promise<void> {
  const who = driver();
  const disturbs = who && who !== "you" && isBusy();
  if (disturbs && !(await ask(`${capital(who)} is driving.`, `${what} all the same?`, what))) return;
  await act();
}
