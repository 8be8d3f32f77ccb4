/** Drive: the robot in its hall, and everything to drive it by. */

import { WHEELS, type Context, type View } from "../context";
import { call, live } from "../net";
import { MAPPINGS } from "../gamepad";
import { Plan } from "../plan";
import { pictureSignals } from "../poses";
import type { Camera, Picture } from "../scene";
import { makeStick } from "../stick";
import { field, h, number, quality, setText, toast } from "../ui";

const LIGHTS = ["off", "dim", "high beam", "flash all", "flash left", "flash right", "pulsation", "rotation", "running"];
const DUTY = 2;
const WHEEL_NAMES: Record<string, string> = { fl: "front left", rl: "rear left", fr: "front right", rr: "rear right" };

export function driveView(context: Context): View {
  const { robot } = context;
  const { wheel: hand } = context;
  const stick = makeStick((x, y) => hand.twist(x, y, stick.held));

  // --- the picture ------------------------------------------------------------------------------

  const stage = h("div", { class: "stage" });
  let scene: Picture | null = null;
  let closed = false;
  function draw(picture: Picture): void {
    scene = picture;
    stage.prepend(picture.element, picture.keys);
    picture.watch(stage);
    live.want("scene", pictureSignals(context));
  }
  import("../scene")
    .then(({ Scene }) => closed || draw(new Scene(context)))
    .catch(() => {
      if (closed) return;
      stage.classList.add("plain");
      draw(new Plan(context));
      stage.append(h("p", { class: "note flat" }, "Seen from above: WebGL is off in this browser."));
      for (const button of cameras.children) (button as HTMLElement).hidden = button.textContent === "Orbit";
      (cameras.children[2] as HTMLElement).click();
    });

  const cameras = h("div", { class: "segments", role: "group", "aria-label": "Camera" });
  for (const name of ["orbit", "follow", "top"] as Camera[]) {
    cameras.append(
      h("button", { type: "button", "aria-pressed": String(name === "orbit"), onclick: (event: Event) => {
        for (const other of cameras.children) other.setAttribute("aria-pressed", String(other === event.currentTarget));
        scene?.look(name);
      } }, name.charAt(0).toUpperCase() + name.slice(1)),
    );
  }
  const clear = h("button", { type: "button", class: "quiet", onclick: () => scene?.clearTrail() }, "Clear trail");

  // --- twist or single wheels -------------------------------------------------------------------

  const held = new Set<HTMLInputElement>();
  const sliders = WHEELS.map((wheel) => {
    const input = h("input", { type: "range", min: -100, max: 100, value: 0, step: 5, "data-arrows": "own", "aria-label": `${WHEEL_NAMES[wheel]} wheel, percent forward; returns to zero when released` });
    const shown = h("output", {}, "0");
    const spring = (): void => {
      held.delete(input);
      input.value = "0";
      wheels();
    };
    input.addEventListener("pointerdown", () => held.add(input));
    input.addEventListener("keydown", (event) => {
      if (!event.repeat && /^(Arrow|Page|Home|End)/.test(event.key)) held.add(input);
    });
    input.addEventListener("input", () => {
      if (!held.has(input)) input.value = "0"; // it was halted, and not let go since
      wheels();
    });
    for (const name of ["pointerup", "pointercancel", "blur", "keyup"]) input.addEventListener(name, spring);
    return { wheel, input, shown };
  });

  function wheels(): void {
    const rpm = sliders.map(({ wheel, input, shown }) => {
      const forward = (Number(input.value) / 100) * hand.share * robot.max_rpm;
      setText(shown, number(forward));
      return wheel[1] === "l" ? forward : -forward;
    });
    hand.wheels(rpm as [number, number, number, number], () => held.size > 0);
  }

  const wheelBox = h(
    "div",
    { class: "wheels", hidden: true },
    ...sliders.map(({ wheel, input, shown }) => h("label", {}, h("span", {}, wheel.toUpperCase()), input, shown)),
  );
  const modes = h("div", { class: "segments", role: "group", "aria-label": "Command" });
  for (const [name, one] of [["Twist", true], ["Single wheels", false]] as const) {
    modes.append(
      h("button", { type: "button", "aria-pressed": String(one), onclick: (event: Event) => {
        for (const other of modes.children) other.setAttribute("aria-pressed", String(other === event.currentTarget));
        if (live.drives) hand.halt();
        wheelBox.hidden = one;
        stick.element.hidden = !one;
      } }, name),
    );
  }

  const limit = h("input", { type: "range", min: 5, max: 100, step: 5, value: hand.share * 100 });
  const limitShown = h("output", {}, `${hand.share * 100} %`);
  limit.addEventListener("input", () => {
    hand.share = Number(limit.value) / 100;
    setText(limitShown, `${limit.value} %`);
  });

  const halt = h("button", { type: "button", class: "halt", "aria-keyshortcuts": "S", onclick: () => hand.halt() }, "Stop driving ", h("kbd", {}, "S"));
  hand.onStick = (x, y) => stick.show(x, y);
  hand.onHalt = () => {
    stick.release();
    held.clear();
    for (const { input, shown } of sliders) [input.value, shown.textContent] = ["0", "0"];
  };

  // --- lights -----------------------------------------------------------------------------------

  const light = h("select", {}, ...LIGHTS.map((name, i) => h("option", { value: i }, name)));
  light.addEventListener("change", async () => {
    const pattern = Number(light.value);
    if (pattern) await paint(); // a colour that nobody has chosen yet is black
    await write("lights.command", pattern);
  });
  const colour = h("input", { type: "color", value: "#ffd080", "aria-label": "Colour of the lights" });
  colour.addEventListener("change", () => void paint());
  async function paint(): Promise<void> {
    const value = parseInt(colour.value.slice(1), 16);
    await write("lights.red", value >> 16);
    await write("lights.green", (value >> 8) & 255);
    await write("lights.blue", value & 255);
  }
  async function write(name: string, value: number): Promise<void> {
    await call("write", name, value).catch((error: Error) => toast(error.message, "error"));
  }

  const pads = h("select", {}, ...Object.entries(MAPPINGS).map(([name, { title }]) => h("option", { value: name }, title)));
  pads.value = hand.mapping;
  const padStop = h("dd", {});
  const showPad = (): void => setText(padStop, `emergency stop of the gamepad: ${MAPPINGS[hand.mapping]!.stopName}`);
  pads.addEventListener("change", () => {
    hand.mapping = pads.value;
    showPad();
  });
  showPad();

  // --- instruments ------------------------------------------------------------------------------

  const at = (axis: string): string => `${robot.has_body ? "mech" : "pose"}.${axis}`; // of the robot that is shown
  const rows: [string, string, string, () => number][] = [
    ["velocity.linear_m_s", "Speed", "m/s", () => live.value("velocity.linear_m_s")],
    ["velocity.angular_rad_s", "Turn rate", "rad/s", () => live.value("velocity.angular_rad_s")],
    [at("x_m"), "x", "m", () => live.value(at("x_m"))],
    [at("y_m"), "y", "m", () => live.value(at("y_m"))],
    [at("yaw_rad"), "Heading", "°", () => (live.value(at("yaw_rad")) * 180) / Math.PI],
    ["sim.time_s", "Time", "s", () => live.value("sim.time_s")],
  ];
  const dials = rows.map(([name, label, unit, read]) => {
    const value = h("b", {}, "–");
    return { name, read, value, element: h("div", { class: "dial" }, h("span", {}, label), h("span", {}, value, h("i", {}, unit))) };
  });
  const bars = WHEELS.map((wheel) => {
    const actual = h("div", { class: "actual" });
    const wanted = h("div", { class: "wanted" });
    const value = h("b", {}, "–");
    return { wheel, actual, wanted, value, element: h("div", { class: "bar-row" }, h("span", {}, wheel.toUpperCase()), h("div", { class: "track", "aria-hidden": "true" }, actual, wanted), value) };
  });
  const finders = ["fl", "fr", "rl", "rr"].map((place) => {
    const value = h("b", {}, "–");
    return { place, value, element: h("div", { class: "dial small" }, h("span", {}, `ToF ${place.toUpperCase()}`), h("span", {}, value, h("i", {}, "m"))) };
  });

  function instruments(): void {
    for (const { name, read, value } of dials) {
      setText(value, number(read()));
      const kind = quality(live.get(name)?.status ?? 0x80000000);
      if (value.dataset.quality !== kind) value.dataset.quality = kind;
    }
    const byDuty = live.value("control.mode") === DUTY;
    for (const { wheel, actual, wanted, value } of bars) {
      if (wanted.hidden !== byDuty) wanted.hidden = byDuty; // no speed is demanded then
      const sign = wheel[1] === "l" ? 1 : -1;
      const speed = sign * live.value(`wheel.${wheel}.speed_rpm`);
      place(actual, speed / robot.max_rpm);
      place(wanted, (sign * live.value(`wheel.${wheel}.demand_rpm`)) / robot.max_rpm, true);
      setText(value, Number.isFinite(speed) ? speed.toFixed(0).replace(/^-0$/, "0").replace("-", "\u2212") : "–");
    }
    for (const { place: at, value } of finders) {
      const reading = live.get(`tof.${at}_m`);
      setText(value, reading && reading.value < 4.99 ? number(reading.value) : "> 5");
    }
    const pattern = live.value("lights.command");
    if (Number.isFinite(pattern) && document.activeElement !== light) light.value = String(pattern);
  }

  function place(bar: HTMLElement, part: number, mark = false): void {
    const value = Math.max(-1, Math.min(1, Number.isFinite(part) ? part : 0));
    const transform = mark ? `translateX(${(value * 50).toFixed(1)}cqw)` : `scaleX(${value.toFixed(3)})`;
    if (bar.style.transform !== transform) bar.style.transform = transform;
  }

  live.want("drive", [
    ...rows.map(([name]) => name),
    ...WHEELS.flatMap((wheel) => [`wheel.${wheel}.speed_rpm`, `wheel.${wheel}.demand_rpm`]),
    ...["fl", "fr", "rl", "rr"].map((at) => `tof.${at}_m`),
    "lights.command",
    "control.mode",
  ]);

  const stopFrames = live.onFrame(instruments);

  const element = h(
    "div",
    { class: "drive" },
    stage,
    h("div", { class: "overlay cameras" }, cameras, clear),
    h(
      "section",
      { class: "panel instruments", "aria-label": "Instruments" },
      h("div", { class: "dials" }, ...dials.map((dial) => dial.element)),
      h("div", { class: "bars" }, h("h2", {}, "Wheels, rpm forward"), ...bars.map((bar) => bar.element)),
      h("div", { class: "dials finders" }, ...finders.map((finder) => finder.element)),
    ),
    h(
      "section",
      { class: "panel steering", "aria-label": "Steering" },
      modes,
      stick.element,
      wheelBox,
      h("label", { class: "limit" }, h("span", {}, "Speed limit"), limit, limitShown),
      halt,
      h("div", { class: "lights" }, field("Lights", light), colour),
      h("details", { class: "keyboard" },
        h("summary", {}, "Keys: ", h("kbd", {}, "X"), " or ", h("kbd", {}, "Esc"), " emergency stop"),
        field("Gamepad", pads),
        h("dl", {},
          h("dt", {}, h("kbd", {}, "pad")), padStop,
          h("dt", {}, h("kbd", {}, "X")), h("dd", {}, "emergency stop, except while you type a text"),
          h("dt", {}, h("kbd", {}, "Esc")), h("dd", {}, "emergency stop while you drive, in every field and dialogue; space, too, where it presses nothing"),
          h("dt", {}, h("kbd", {}, "S")), h("dd", {}, "lets go: everything to zero"),
          h("dt", {}, h("kbd", {}, "↑"), h("kbd", {}, "↓"), h("kbd", {}, "←"), h("kbd", {}, "→")), h("dd", {}, "drive while held, in every view; a text, a number or a list keeps them. Sliders then move by Page up and Page down"))),
    ),
  );

  return {
    element,
    close() {
      closed = true;
      hand.onStick = hand.onHalt = () => {};
      scene?.close();
      stopFrames();
      live.want("drive", []);
      live.want("scene", []);
    },
  };
}
