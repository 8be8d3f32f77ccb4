/** The hall in three dimensions. Drawn only when something has changed. */

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Context } from "./context";
import { WHEELS } from "./context";
import { live } from "./net";
import { h, quality } from "./ui";

export type Camera = "orbit" | "follow" | "top";

const TRAIL = 3000;
const TRAIL_STEP_M = 0.015;
const WALL_HEIGHT_M = 0.5;
const CORNERS = ["fl", "fr", "rl", "rr"] as const;
const FAR_M = 4.99;

interface Palette {
  floor: number;
  grid: number;
  wall: number;
  sky: number;
  body: number;
  trail: number;
}

const LIGHT: Palette = { floor: 0xe8ecf1, grid: 0xc9d1da, wall: 0xa7b3c0, sky: 0xdfe6ee, body: 0x1464b4, trail: 0x0b6bcb };
const DARK: Palette = { floor: 0x1a212b, grid: 0x2b3643, wall: 0x46566a, sky: 0x10161e, body: 0x3b8be0, trail: 0x58a6ff };

function isDark(): boolean {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

/** A second robot, translucent: where another model, or the real one, is. */
interface Ghost {
  name: string;
  signals: string[];
  group: THREE.Group;
  key: HTMLElement;
}

const GHOSTS = [
  { name: "Body", colour: 0x0f8a6d, signals: ["mech.x_m", "mech.y_m", "mech.yaw_rad", "mech.z_m", "mech.roll_rad", "mech.pitch_rad"] },
  { name: "Measured", colour: 0xd97706, signals: ["x_m", "y_m", "yaw_rad"].map((axis) => `measured.pose.${axis}`) },
  { name: "Measured tag", colour: 0xb4308f, signals: ["x_m", "y_m", "yaw_rad"].map((axis) => `measured.nav.${axis}`) },
];

function lampOf(place: string): string[] {
  return ["red", "green", "blue"].map((colour) => `lights.${place}.${colour}`);
}

class RobotModel {
  readonly group = new THREE.Group();
  readonly wheels: THREE.Group[] = [];
  private lamps: THREE.MeshStandardMaterial[] = [];

  constructor(context: Context, palette: Palette, ghost: boolean) {
    const robot = context.robot;
    const radius = robot.wheel_radius_m;
    const base = robot.wheelbase_m ?? 0;
    const wide = robot.track_m - 0.07;
    const long = Math.max(base + radius * 1.1, 0.3);
    const material = (color: number, extra = {}): THREE.MeshStandardMaterial =>
      new THREE.MeshStandardMaterial({ color: ghost ? palette.body : color, roughness: 0.55, metalness: 0.1, transparent: ghost, opacity: ghost ? 0.4 : 1, depthWrite: !ghost, ...extra });
    const body = new THREE.Mesh(new THREE.BoxGeometry(long, wide, 0.11), material(palette.body));
    body.position.z = radius + 0.035;
    const deck = new THREE.Mesh(new THREE.BoxGeometry(long * 0.62, wide * 0.78, 0.03), material(0x202a36));
    deck.position.set(-0.02, 0, radius + 0.1);
    const nose = new THREE.Mesh(new THREE.ConeGeometry(0.035, 0.08, 3), material(0xffffff));
    nose.rotation.z = -Math.PI / 2;
    nose.position.set(long * 0.36, 0, radius + 0.1);
    for (const part of [body, deck, nose]) {
      part.castShadow = !ghost;
      this.group.add(part);
    }
    const tyre = new THREE.CylinderGeometry(radius, radius, 0.06, 24);
    const spoke = new THREE.BoxGeometry(radius * 1.5, 0.064, 0.022);
    for (const name of WHEELS) {
      const wheel = new THREE.Group();
      const rubber = new THREE.Mesh(tyre, material(0x22272e));
      rubber.castShadow = !ghost;
      wheel.add(rubber);
      for (const turn of [0, Math.PI / 2]) {
        const bar = new THREE.Mesh(spoke, material(0xc8d0d9));
        bar.rotation.y = turn;
        wheel.add(bar);
      }
      const x = base ? (name[0] === "f" ? base / 2 : -base / 2) : 0;
      wheel.position.set(x, ((name[1] === "l" ? 1 : -1) * robot.track_m) / 2, radius);
      this.wheels.push(wheel);
      this.group.add(wheel);
    }
    if (ghost) return;
    const lamp = new THREE.BoxGeometry(0.02, 0.06, 0.035);
    for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]] as const) {
      const shine = new THREE.MeshStandardMaterial({ color: 0x333a43, emissive: 0x000000 });
      const box = new THREE.Mesh(lamp, shine);
      box.position.set((x * long) / 2, y * (wide / 2 - 0.04), radius + 0.045);
      this.lamps.push(shine);
      this.group.add(box);
    }
  }

  /** Show each lamp as it blinks now. */
  light(): void {
    this.lamps.forEach((lamp, i) => {
      const [red, green, blue] = lampOf(CORNERS[i]!).map((name) => (live.value(name) || 0) / 255);
      lamp.emissive.setRGB(red!, green!, blue!, THREE.SRGBColorSpace);
    });
  }
}

/** Everything drawn. Throws where there is no WebGL. */
export class Scene {
  readonly element: HTMLElement;
  /** Which ghost has which colour; empty while there are none. */
  readonly keys = h("ul", { class: "keys" });
  rays = true;
  private renderer: THREE.WebGLRenderer;
  private scene = new THREE.Scene();
  private camera = new THREE.PerspectiveCamera(45, 1, 0.05, 100);
  private controls: OrbitControls;
  private robot: RobotModel;
  private ghosts: Ghost[] = [];
  private finder: THREE.LineSegments;
  private trail: THREE.Line;
  private trailCount = 0;
  private lastTrail = { x: NaN, y: NaN };
  private mode: Camera = "orbit";
  private dirty = true;
  private signature = "";
  private request = 0;
  private observer: ResizeObserver;
  private stopFrames: () => void;
  private palette = isDark() ? DARK : LIGHT;
  private readonly signals: string[];

  constructor(private context: Context) {
    this.signals = Scene.signals(context);
    this.renderer = new THREE.WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.element = this.renderer.domElement;
    this.element.setAttribute("role", "img");
    this.element.setAttribute("aria-label", "The robot in its hall; the figures below say the same");
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.element);
    this.controls.maxPolarAngle = Math.PI / 2 - 0.05;
    this.controls.minDistance = 0.6;
    this.controls.maxDistance = 30;
    this.controls.addEventListener("change", () => this.changed());
    this.robot = new RobotModel(context, this.palette, false);
    this.finder = new THREE.LineSegments(
      new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(24), 3)),
      new THREE.LineBasicMaterial({ color: 0xe0572b, transparent: true, opacity: 0.75 }),
    );
    this.finder.frustumCulled = false;
    this.trail = new THREE.Line(
      new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(TRAIL * 3), 3)),
      new THREE.LineBasicMaterial({ color: this.palette.trail, transparent: true, opacity: 0.8 }),
    );
    this.trail.frustumCulled = false;
    this.trail.geometry.setDrawRange(0, 0);
    this.build();
    this.observer = new ResizeObserver(() => this.resize());
    this.look("orbit");
    this.stopFrames = live.onFrame(() => this.changed());
    window.addEventListener("themechange", this.retheme);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", this.retheme);
  }

  watch(parent: HTMLElement): void {
    this.observer.observe(parent);
  }

  /** Signals that the picture is made of. */
  static signals(context: Context): string[] {
    const names = ["pose.x_m", "pose.y_m", "pose.yaw_rad"];
    for (const wheel of WHEELS) names.push(`wheel.${wheel}.angle_rad`);
    for (const corner of CORNERS) names.push(`tof.${corner}_m`, ...lampOf(corner));
    for (const { signals } of GHOSTS) names.push(...signals);
    const known = new Set(context.signals.map((signal) => signal.name));
    return names.filter((name) => known.has(name));
  }

  look(mode: Camera): void {
    this.mode = mode;
    this.controls.enableRotate = mode === "orbit";
    const [x, y] = this.pose();
    const [cx, cy, size] = this.middle();
    if (mode === "top") {
      this.controls.target.set(cx, cy, 0);
      this.camera.position.set(cx, cy - 0.01, size * 1.35);
    } else if (mode === "orbit") {
      this.controls.target.set(cx, cy - size * 0.03, 0);
      this.camera.position.set(cx - size * 0.5, cy - size * 0.72, size * 0.62);
    } else {
      this.controls.target.set(x, y, 0.15);
    }
    this.controls.update();
    this.changed();
  }

  clearTrail(): void {
    this.trailCount = 0;
    this.trail.geometry.setDrawRange(0, 0);
    this.changed();
  }

  close(): void {
    this.stopFrames();
    this.observer.disconnect();
    window.removeEventListener("themechange", this.retheme);
    matchMedia("(prefers-color-scheme: dark)").removeEventListener("change", this.retheme);
    cancelAnimationFrame(this.request);
    this.controls.dispose();
    this.scene.traverse((part) => {
      if (part instanceof THREE.Mesh || part instanceof THREE.Line) part.geometry.dispose();
    });
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private retheme = (): void => {
    this.palette = isDark() ? DARK : LIGHT;
    this.scene.clear();
    this.robot = new RobotModel(this.context, this.palette, false);
    this.build();
    this.signature = "";
    this.changed();
  };

  private middle(): [number, number, number] {
    const walls = this.context.walls;
    if (!walls.length) return [0, 0, 6];
    const xs = walls.flatMap((w) => [w[0], w[2]]);
    const ys = walls.flatMap((w) => [w[1], w[3]]);
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    return [(x0 + x1) / 2, (y0 + y1) / 2, Math.max(x1 - x0, y1 - y0)];
  }

  private build(): void {
    const p = this.palette;
    const [cx, cy, size] = this.middle();
    this.scene.background = new THREE.Color(p.sky);
    this.scene.fog = new THREE.Fog(p.sky, size * 1.8, size * 4);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8090a0, isDark() ? 1.1 : 1.9));
    const sun = new THREE.DirectionalLight(0xffffff, isDark() ? 1.0 : 1.6);
    sun.position.set(cx - size * 0.4, cy - size * 0.3, size);
    sun.target.position.set(cx, cy, 0);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    const reach = size * 0.6;
    Object.assign(sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, far: size * 3 });
    this.scene.add(sun, sun.target);
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(size * 6, size * 6), new THREE.MeshStandardMaterial({ color: p.floor, roughness: 1 }));
    floor.position.set(cx, cy, 0);
    floor.receiveShadow = true;
    const cells = Math.ceil(size * 1.5);
    const grid = new THREE.GridHelper(cells, cells, p.grid, p.grid);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(Math.round(cx), Math.round(cy), 0.002);
    this.scene.add(floor, grid);
    const material = new THREE.MeshStandardMaterial({ color: p.wall, roughness: 0.9 });
    for (const [x1, y1, x2, y2] of this.context.walls) {
      const length = Math.hypot(x2 - x1, y2 - y1);
      const wall = new THREE.Mesh(new THREE.BoxGeometry(length + 0.05, 0.05, WALL_HEIGHT_M), material);
      wall.position.set((x1 + x2) / 2, (y1 + y2) / 2, WALL_HEIGHT_M / 2);
      wall.rotation.z = Math.atan2(y2 - y1, x2 - x1);
      wall.castShadow = wall.receiveShadow = true;
      this.scene.add(wall);
    }
    (this.trail.material as THREE.LineBasicMaterial).color.set(p.trail);
    this.scene.add(this.robot.group, this.finder, this.trail);
    this.ghosts = GHOSTS.map(({ name, colour, signals }) => {
      const { group } = new RobotModel(this.context, { ...p, body: colour }, true);
      group.visible = false;
      group.rotation.order = "ZYX";
      const swatch = h("span", { class: "swatch" });
      swatch.style.background = `#${colour.toString(16).padStart(6, "0")}`;
      this.scene.add(group);
      return { name, signals, group, key: h("li", { hidden: true }, swatch, name) };
    });
    this.keys.replaceChildren(...this.ghosts.map(({ key }) => key));
  }

  private pose(): [number, number, number] {
    const [x, y, yaw] = ["x_m", "y_m", "yaw_rad"].map((axis) => live.value(`pose.${axis}`));
    return [x || 0, y || 0, yaw || 0];
  }

  private changed(): void {
    this.dirty = true;
    if (!this.request) this.request = requestAnimationFrame(() => this.draw());
  }

  private resize(): void {
    const parent = this.element.parentElement;
    if (!parent?.clientWidth || !parent.clientHeight) return;
    this.renderer.setSize(parent.clientWidth, parent.clientHeight);
    this.camera.aspect = parent.clientWidth / parent.clientHeight;
    this.camera.fov = this.camera.aspect < 1 ? 62 : 45;
    this.camera.updateProjectionMatrix();
    this.signature = "";
    this.changed();
  }

  private draw(): void {
    this.request = 0;
    const { position, quaternion } = this.camera;
    const view = `${position.x.toFixed(4)},${position.y.toFixed(4)},${position.z.toFixed(4)},${quaternion.x.toFixed(4)}`;
    const signature = `${this.signals.map((name) => live.value(name)).join()}|${view}|${this.rays}|${this.trailCount}`;
    if (!this.dirty || signature === this.signature) return;
    this.signature = signature;
    this.dirty = false;
    this.place();
    this.renderer.render(this.scene, this.camera);
  }

  private place(): void {
    const [x, y, yaw] = this.pose();
    this.robot.group.position.set(x, y, 0);
    this.robot.group.rotation.z = yaw;
    WHEELS.forEach((wheel, i) => {
      const angle = live.value(`wheel.${wheel}.angle_rad`) || 0;
      this.robot.wheels[i]!.rotation.y = wheel[1] === "l" ? angle : -angle;
    });
    this.placeRays(x, y, yaw);
    this.extendTrail(x, y);
    this.ghosts.forEach((ghost) => this.placeGhost(ghost));
    this.robot.light();
    if (this.mode === "follow") {
      const back = 1.9;
      this.camera.position.set(x - back * Math.cos(yaw), y - back * Math.sin(yaw), 1.05);
      this.controls.target.set(x + 0.6 * Math.cos(yaw), y + 0.6 * Math.sin(yaw), 0.1);
      this.camera.lookAt(this.controls.target);
    }
  }

  private placeGhost({ signals, group, key }: Ghost): void {
    const [x, y, yaw, z, roll, pitch] = signals.map((name) => {
      const reading = live.get(name);
      return reading && quality(reading.status) !== "bad" && quality(reading.status) !== "uncertain" ? reading.value : NaN;
    });
    group.visible = Number.isFinite(x! + y! + yaw!) && (x !== 0 || y !== 0 || yaw !== 0);
    key.hidden = !group.visible;
    if (!group.visible) return;
    group.position.set(x!, y!, z === undefined ? 0 : z - this.context.robot.mass_height_m);
    group.rotation.set(roll ?? 0, pitch ?? 0, yaw!);
  }

  private placeRays(x: number, y: number, yaw: number): void {
    const { tof_x_m: mx, tof_y_m: my } = this.context.robot;
    const points = this.finder.geometry.getAttribute("position") as THREE.BufferAttribute;
    CORNERS.forEach((name, i) => {
      const range = live.value(`tof.${name}_m`);
      const forward = name[0] === "f" ? 1 : -1;
      const side = name[1] === "l" ? my : -my;
      const seen = Number.isFinite(range) && range < FAR_M;
      const sx = x + forward * mx * Math.cos(yaw) - side * Math.sin(yaw);
      const sy = y + forward * mx * Math.sin(yaw) + side * Math.cos(yaw);
      const length = seen ? range * forward : 0;
      points.setXYZ(2 * i, sx, sy, 0.12);
      points.setXYZ(2 * i + 1, sx + length * Math.cos(yaw), sy + length * Math.sin(yaw), 0.12);
    });
    points.needsUpdate = true;
    this.finder.visible = this.rays;
  }

  private extendTrail(x: number, y: number): void {
    const moved = Math.hypot(x - this.lastTrail.x, y - this.lastTrail.y);
    if (moved < TRAIL_STEP_M) return;
    if (moved > 0.5) this.trailCount = 0;
    this.lastTrail = { x, y };
    const points = this.trail.geometry.getAttribute("position") as THREE.BufferAttribute;
    const array = points.array as Float32Array;
    if (this.trailCount === TRAIL) {
      array.copyWithin(0, 3 * (TRAIL / 2));
      this.trailCount = TRAIL / 2;
    }
    points.setXYZ(this.trailCount, x, y, 0.012);
    this.trailCount += 1;
    points.needsUpdate = true;
    this.trail.geometry.setDrawRange(0, this.trailCount);
  }
}
