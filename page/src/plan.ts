/** The hall from above, drawn without WebGL: the same robot, walls, rays and trail. */

import { WHEELS, type Context } from "./context";
import { live } from "./net";
import { ellipse95, ghostPose, ghosts, gridStep, hallOf, rays, robotPose, robotSize, TRAIL_STEP_M, type Pose } from "./poses";
import type { Camera, Picture } from "./scene";
import { h } from "./ui";

const TRAIL = 3000;
const MARGIN = 0.08;

export class Plan implements Picture {
  readonly element = h("canvas", { role: "img", "aria-label": "The hall from above; the values below give the same information" });
  readonly keys = h("ul", { class: "keys" });
  private trail: [number, number][] = [];
  private follows = false;
  private request = 0;
  private observer = new ResizeObserver(() => this.changed());
  private stopFrames = live.onFrame(() => this.changed());
  private redraw = (): void => this.changed();

  constructor(private context: Context) {
    window.addEventListener("themechange", this.redraw);
  }

  watch(parent: HTMLElement): void {
    this.observer.observe(parent);
  }

  look(camera: Camera): void {
    this.follows = camera === "follow";
    this.changed();
  }

  clearTrail(): void {
    this.trail = [];
    this.changed();
  }

  close(): void {
    this.stopFrames();
    this.observer.disconnect();
    window.removeEventListener("themechange", this.redraw);
    cancelAnimationFrame(this.request);
  }

  private changed(): void {
    if (!this.request) this.request = requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    this.request = 0;
    const parent = this.element.parentElement;
    const pen = this.element.getContext("2d");
    if (!parent?.clientWidth || !parent.clientHeight || !pen) return;
    const ratio = Math.min(devicePixelRatio, 2);
    const [wide, high] = [parent.clientWidth, parent.clientHeight];
    if (this.element.width !== Math.round(wide * ratio) || this.element.height !== Math.round(high * ratio)) {
      Object.assign(this.element, { width: Math.round(wide * ratio), height: Math.round(high * ratio) });
      this.element.style.width = `${wide}px`;
      this.element.style.height = `${high}px`;
    }
    const style = getComputedStyle(document.documentElement);
    const ink = (name: string): string => style.getPropertyValue(`--${name}`).trim();
    const hall = hallOf(this.context);
    const pose = robotPose(this.context);
    const far = Math.max(Math.abs(pose.x - hall.x), Math.abs(pose.y - hall.y)) > hall.size * 0.55;
    const near = this.follows || far;
    const [cx, cy] = near ? [pose.x, pose.y] : [hall.x, hall.y];
    const [spanX, spanY] = this.follows ? Array(2).fill(8 * robotSize(this.context)) : [hall.right - hall.left, hall.top - hall.bottom];
    const scale = Math.min((wide * (1 - 2 * MARGIN)) / Math.max(spanX, 0.5), (high * (1 - 2 * MARGIN)) / Math.max(spanY, 0.5));
    const toX = (x: number): number => wide / 2 + (x - cx) * scale;
    const toY = (y: number): number => high / 2 - (y - cy) * scale;

    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = ink("soft");
    pen.fillRect(0, 0, wide, high);
    if (this.context.walls.length) {
      pen.fillStyle = ink("panel");
      pen.fillRect(toX(hall.left), toY(hall.top), (hall.right - hall.left) * scale, (hall.top - hall.bottom) * scale);
    }
    this.grid(pen, ink, { wide, high, cx, cy, scale }, toX, toY);
    const line = (points: [number, number][], colour: string, width: number): void => {
      pen.beginPath();
      points.forEach(([x, y], i) => (i ? pen.lineTo(toX(x), toY(y)) : pen.moveTo(toX(x), toY(y))));
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
    };
    for (const [x1, y1, x2, y2] of this.context.walls) line([[x1, y1], [x2, y2]], ink("muted"), 4);
    this.extend(pose);
    line(this.trail, ink("accent"), 1.5);
    for (const ray of rays(this.context)) if (ray) line([[ray[0], ray[1]], [ray[2], ray[3]]], "#e0572b", 1.5);
    const shown = ghosts(this.context).flatMap((ghost) => {
      const at = ghostPose(ghost);
      return at ? [{ ...ghost, at }] : [];
    });
    for (const ghost of shown) {
      const around = ellipse95(ghost);
      if (!around) continue;
      pen.beginPath();
      pen.ellipse(toX(ghost.at.x), toY(ghost.at.y), around.long * scale, around.short * scale, -around.turn, 0, 2 * Math.PI);
      pen.strokeStyle = ghost.colour;
      pen.lineWidth = 1.5;
      pen.stroke();
    }
    for (const { at, colour } of shown) this.robot(pen, toX(at.x), toY(at.y), at.yaw, scale, colour, 0.45);
    this.robot(pen, toX(pose.x), toY(pose.y), pose.yaw, scale, ink("accent"), 1);
    const names = shown.map(({ name }) => name).join();
    if (this.keys.dataset.names !== names) {
      this.keys.dataset.names = names;
      this.keys.replaceChildren(...shown.map(({ name, colour }) => {
        const swatch = h("span", { class: "swatch" });
        swatch.style.background = colour;
        return h("li", {}, swatch, name);
      }));
    }
  }

  private grid(
    pen: CanvasRenderingContext2D,
    ink: (name: string) => string,
    { wide, high, cx, cy, scale }: Record<"wide" | "high" | "cx" | "cy" | "scale", number>,
    toX: (x: number) => number,
    toY: (y: number) => number,
  ): void {
    const step = gridStep(Math.max(wide, high) / scale);
    const [right, top] = [cx + wide / 2 / scale, cy + high / 2 / scale];
    pen.strokeStyle = ink("line");
    pen.lineWidth = 1;
    pen.beginPath();
    for (let x = Math.ceil((2 * cx - right) / step) * step; x < right; x += step) pen.rect(toX(x), 0, 0, high);
    for (let y = Math.ceil((2 * cy - top) / step) * step; y < top; y += step) pen.rect(0, toY(y), wide, 0);
    pen.stroke();
    const [left, base] = [wide - 20 - step * scale, high - 16];
    pen.strokeStyle = pen.fillStyle = ink("ink");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(left, base - 5);
    pen.lineTo(left, base);
    pen.lineTo(left + step * scale, base);
    pen.lineTo(left + step * scale, base - 5);
    pen.stroke();
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.fillText(`${step} m`, left + (step * scale) / 2, base - 7);
  }

  private robot(pen: CanvasRenderingContext2D, x: number, y: number, yaw: number, scale: number, colour: string, opacity: number): void {
    const { wheelbase_m, track_m, wheel_radius_m: radius } = this.context.robot;
    const base = (wheelbase_m ?? 0) * scale;
    const [long, wide] = [base + 2.2 * radius * scale, track_m * scale];
    pen.save();
    pen.globalAlpha = opacity;
    pen.translate(x, y);
    pen.rotate(-yaw);
    pen.fillStyle = "#5b6672";
    for (const name of WHEELS) {
      const along = (name[0] === "f" ? base : -base) / 2;
      const aside = (name[1] === "l" ? -wide : wide) / 2;
      pen.fillRect(along - radius * scale, aside - wide * 0.07, 2 * radius * scale, wide * 0.14);
    }
    pen.fillStyle = colour;
    pen.fillRect(-long / 2, -wide * 0.42, long, wide * 0.84);
    pen.fillStyle = "#ffffff";
    pen.beginPath();
    pen.moveTo(long * 0.42, 0);
    pen.lineTo(long * 0.2, -wide * 0.16);
    pen.lineTo(long * 0.2, wide * 0.16);
    pen.fill();
    pen.restore();
  }

  private extend({ x, y }: Pose): void {
    const last = this.trail[this.trail.length - 1];
    const moved = last ? Math.hypot(x - last[0], y - last[1]) : Infinity;
    if (moved > 1) this.trail = []; // it was put elsewhere
    if (moved > TRAIL_STEP_M) this.trail.push([x, y]);
    if (this.trail.length > TRAIL) this.trail.shift();
  }
}
