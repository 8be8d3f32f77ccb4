/** The hall in three dimensions. Drawn only when something has changed. */

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Context } from "./context";
import { WHEELS } from "./context";
import { live } from "./net";
import { CORNERS, ellipse95, ghostPose, ghosts, gridStep, hallOf, lampOf, pictureSignals, rays, robotPose, robotSize, TRAIL_STEP_M, type Ghost, type Pose } from "./poses";
import { h } from "./ui";

export type Camera = "orbit" | "follow" | "top";

/** What draws the hall and the robot. */
export interface Picture {
  readonly element: HTMLElement;
  /** Which ghost has which colour; empty while there are none. */
  readonly keys: HTMLElement;
  watch(parent: HTMLElement): void;
  look(camera: Camera): void;
  clearTrail(): void;
  close(): void;
}

const TRAIL = 3000;
const WALL_HEIGHT_M = 0.5;
const USUAL_M = 0.6; // the robot that all distances of the camera were chosen for

interface Palette {
  floor: number;
  outside: number;
  ink: string;
  grid: number;
  wall: number;
  sky: number;
  body: number;
  trail: number;
}

const LIGHT: Palette = { floor: 0xe8ecf1, outside: 0xd3dbe4, ink: "#3c4856", grid: 0xc9d1da, wall: 0xa7b3c0, sky: 0xdfe6ee, body: 0x1464b4, trail: 0x0b6bcb };
const DARK: Palette = { floor: 0x1a212b, outside: 0x141a22, ink: "#a9b6c4", grid: 0x2b3643, wall: 0x46566a, sky: 0x10161e, body: 0x3b8be0, trail: 0x58a6ff };

function isDark(): boolean {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

/** A second robot, translucent: where another model, or the real one, is. */
interface ShownGhost extends Ghost {
  group: THREE.Group;
  key: HTMLElement;
  around: THREE.LineLoop;
}

/** A circle of 1 m on the floor, to be stretched. */
function ring(colour: string): THREE.LineLoop {
  const points = new THREE.EllipseCurve(0, 0, 1, 1).getPoints(64).map(({ x, y }) => new THREE.Vector3(x, y, 0.02));
  return new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: colour }));
}

/** A word on the floor. */
function label(text: string, colour: string, height: number): THREE.Mesh {
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: 128, height: 48 });
  const pen = canvas.getContext("2d")!;
  pen.font = "30px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillStyle = colour;
  pen.fillText(text, 64, 26);
  const map = new THREE.CanvasTexture(canvas);
  const mesh = new THREE.Mesh(new THREE.PlaneGeometry((height * 128) / 48, height), new THREE.MeshBasicMaterial({ map, transparent: true, depthWrite: false }));
  mesh.position.z = 0.004;
  return mesh;
}

class RobotModel {
  readonly group = new THREE.Group();
  readonly wheels: THREE.Group[] = [];
  private lamps: THREE.MeshStandardMaterial[] = [];

  constructor(context: Context, palette: Palette, ghost: boolean) {
    const robot = context.robot;
    const radius = robot.wheel_radius_m;
    const base = robot.wheelbase_m ?? 0;
    const k = Math.max(1, robotSize(context) / USUAL_M);
    const wide = robot.track_m - 0.07 * k;
    const long = Math.max(base + radius * 1.1, 0.3);
    const material = (color: number, extra = {}): THREE.MeshStandardMaterial =>
      new THREE.MeshStandardMaterial({ color: ghost ? palette.body : color, roughness: 0.55, metalness: 0.1, transparent: ghost, opacity: ghost ? 0.4 : 1, depthWrite: !ghost, ...extra });
    const body = new THREE.Mesh(new THREE.BoxGeometry(long, wide, 0.11 * k), material(palette.body));
    body.position.z = radius + 0.035 * k;
    const deck = new THREE.Mesh(new THREE.BoxGeometry(long * 0.62, wide * 0.78, 0.03 * k), material(0x202a36));
    deck.position.set(-0.02 * k, 0, radius + 0.1 * k);
    const nose = new THREE.Mesh(new THREE.ConeGeometry(0.035 * k, 0.08 * k, 3), material(0xffffff));
    nose.rotation.z = -Math.PI / 2;
    nose.position.set(long * 0.36, 0, radius + 0.1 * k);
    for (const part of [body, deck, nose]) {
      part.castShadow = !ghost;
      this.group.add(part);
    }
    const tyre = new THREE.CylinderGeometry(radius, radius, 0.06 * k, 24);
    const spoke = new THREE.BoxGeometry(radius * 1.5, 0.064 * k, radius * 0.26);
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
    const lamp = new THREE.BoxGeometry(0.02 * k, 0.06 * k, 0.035 * k);
    for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]] as const) {
      const shine = new THREE.MeshStandardMaterial({ color: 0x333a43, emissive: 0x000000 });
      const box = new THREE.Mesh(lamp, shine);
      box.position.set((x * long) / 2, y * (wide / 2 - 0.04 * k), radius + 0.045 * k);
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
export class Scene implements Picture {
  readonly element: HTMLElement;
  readonly keys = h("ul", { class: "keys" });
  rays = true;
  private renderer: THREE.WebGLRenderer;
  private scene = new THREE.Scene();
  private camera = new THREE.PerspectiveCamera(45, 1, 0.05, 100);
  private controls: OrbitControls;
  private robot: RobotModel;
  private ghosts: ShownGhost[] = [];
  /** Floor and grid, which go along where there are no walls. */
  private ground = new THREE.Group();
  private readonly k: number;
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
    this.signals = pictureSignals(context);
    this.k = Math.max(1, robotSize(context) / USUAL_M);
    this.renderer = new THREE.WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.element = this.renderer.domElement;
    this.element.setAttribute("role", "img");
    this.element.setAttribute("aria-label", "The robot in its hall; the values below give the same information");
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.element);
    this.controls.maxPolarAngle = Math.PI / 2 - 0.05;
    this.controls.minDistance = 0.6;
    this.controls.maxDistance = Math.max(30, 4 * hallOf(context).size);
    this.camera.far = 4 * this.controls.maxDistance;
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
  }

  watch(parent: HTMLElement): void {
    this.observer.observe(parent);
  }

  look(mode: Camera): void {
    this.mode = mode;
    this.controls.enableRotate = mode === "orbit";
    const { x, y } = robotPose(this.context);
    const { size, ...hall } = hallOf(this.context);
    const [cx, cy] = this.context.walls.length ? [hall.x, hall.y] : [x, y];
    if (mode === "top") {
      this.controls.target.set(cx, cy, 0);
      this.camera.position.set(cx, cy - 0.01, size * 1.35);
    } else if (mode === "orbit") {
      this.controls.target.set(cx, cy - size * 0.03, 0);
      this.camera.position.set(cx - size * 0.56, cy - size * 0.85, size * 0.78);
    } else {
      this.controls.target.set(x, y, 0.15 * this.k);
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

  private build(): void {
    const p = this.palette;
    const { x: cx, y: cy, size, ...hall } = hallOf(this.context);
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
    this.ground = new THREE.Group();
    const plane = (wide: number, high: number, color: number, z: number): THREE.Mesh => {
      const mesh = new THREE.Mesh(new THREE.PlaneGeometry(wide, high), new THREE.MeshStandardMaterial({ color, roughness: 1 }));
      mesh.position.set(cx, cy, z);
      mesh.receiveShadow = true;
      return mesh;
    };
    const inside = this.context.walls.length > 0;
    this.ground.add(plane(size * 8, size * 8, inside ? p.outside : p.floor, inside ? -0.004 * this.k : 0));
    if (inside) this.ground.add(plane(hall.right - hall.left, hall.top - hall.bottom, p.floor, 0));
    const step = gridStep(size);
    const cells = 2 * Math.ceil((size * 0.75) / step);
    const grid = new THREE.GridHelper(cells * step, cells, p.grid, p.grid);
    grid.rotation.x = Math.PI / 2;
    grid.position.set(Math.round(cx / step) * step, Math.round(cy / step) * step, 0.002);
    this.ground.add(grid);
    this.scene.add(this.ground);
    if (inside) this.addScale(hall, step, p.ink, size * 0.035);
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
    this.robot.group.rotation.order = "ZYX";
    this.ghosts = ghosts(this.context).map((ghost) => {
      const { group } = new RobotModel(this.context, { ...p, body: Number(`0x${ghost.colour.slice(1)}`) }, true);
      group.visible = false;
      group.rotation.order = "ZYX";
      const swatch = h("span", { class: "swatch" });
      swatch.style.background = ghost.colour;
      const around = ring(ghost.colour);
      around.visible = false;
      this.scene.add(group, around);
      return { ...ghost, group, around, key: h("li", { hidden: true }, swatch, ghost.name) };
    });
    this.keys.replaceChildren(...this.ghosts.map(({ key }) => key));
  }

  /** Metres along two walls. */
  private addScale(hall: { left: number; right: number; bottom: number; top: number }, step: number, ink: string, height: number): void {
    const digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
    for (let x = Math.ceil(hall.left / step) * step; x <= hall.right; x += step) {
      const mark = label(`${x.toFixed(digits).replace(/^-0$/, "0")} m`, ink, height);
      mark.position.setX(x).setY(hall.bottom - height);
      this.scene.add(mark);
    }
    for (let y = Math.ceil(hall.bottom / step) * step; y <= hall.top; y += step) {
      const mark = label(`${y.toFixed(digits).replace(/^-0$/, "0")} m`, ink, height);
      mark.position.setX(hall.left - 1.6 * height).setY(y);
      this.scene.add(mark);
    }
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
    const pose = robotPose(this.context);
    const { x, y, yaw } = pose;
    this.put(this.robot.group, pose);
    WHEELS.forEach((wheel, i) => {
      const angle = live.value(`wheel.${wheel}.angle_rad`) || 0;
      this.robot.wheels[i]!.rotation.y = wheel[1] === "l" ? angle : -angle;
    });
    this.placeRays();
    this.extendTrail(x, y);
    this.ghosts.forEach((ghost) => this.placeGhost(ghost));
    this.robot.light();
    if (this.mode === "follow") {
      const [back, ahead, k] = [1.9 * this.k, 0.6 * this.k, this.k];
      this.camera.position.set(x - back * Math.cos(yaw), y - back * Math.sin(yaw), 1.05 * k);
      this.controls.target.set(x + ahead * Math.cos(yaw), y + ahead * Math.sin(yaw), 0.1 * k);
      this.camera.lookAt(this.controls.target);
    }
    if (!this.context.walls.length) this.goAlong(x, y);
  }

  /** Where no walls say what is to be seen, floor and camera go along with the robot. */
  private goAlong(x: number, y: number): void {
    const { size } = hallOf(this.context);
    const step = gridStep(size);
    this.ground.position.set(Math.round(x / step) * step, Math.round(y / step) * step, 0);
    const { target } = this.controls;
    const [dx, dy] = [x - target.x, y - target.y];
    const excess = Math.hypot(dx, dy) - size * 0.35;
    if (this.mode === "follow" || excess <= 0) return;
    const share = excess / Math.hypot(dx, dy);
    target.add(new THREE.Vector3(dx * share, dy * share, 0));
    this.camera.position.add(new THREE.Vector3(dx * share, dy * share, 0));
    this.controls.update();
  }

  private put(group: THREE.Group, { x, y, z, roll, pitch, yaw }: Pose): void {
    group.position.set(x, y, z);
    group.rotation.set(roll, pitch, yaw);
  }

  private placeGhost(ghost: ShownGhost): void {
    const pose = ghostPose(ghost);
    ghost.group.visible = pose !== null;
    ghost.key.hidden = pose === null;
    if (pose) this.put(ghost.group, pose);
    const ellipse = pose && ellipse95(ghost);
    ghost.around.visible = Boolean(ellipse);
    if (!pose || !ellipse) return;
    ghost.around.position.set(pose.x, pose.y, 0);
    ghost.around.scale.set(Math.max(ellipse.long, 1e-3), Math.max(ellipse.short, 1e-3), 1);
    ghost.around.rotation.z = ellipse.turn;
  }

  private placeRays(): void {
    const points = this.finder.geometry.getAttribute("position") as THREE.BufferAttribute;
    rays(this.context).forEach((ray, i) => {
      const [x1, y1, x2, y2] = ray ?? [0, 0, 0, 0];
      points.setXYZ(2 * i, x1, y1, 0.12 * this.k);
      points.setXYZ(2 * i + 1, x2, y2, 0.12 * this.k);
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
