// A real browser that does what it is asked, one JSON line at a time.
import { createRequire } from "node:module";
import { readFileSync, writeFileSync } from "node:fs";
import { extname } from "node:path";
import readline from "node:readline";
import { chromium } from "playwright-core";

const require = createRequire(import.meta.url);
const [executablePath, webgl] = process.argv.slice(2);
const server = await chromium.launchServer({
  executablePath,
  args: [
    "--headless", "--no-sandbox", "--disable-background-networking", "--mute-audio",
    ...(webgl === "webgl"
      ? ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
      : ["--disable-gpu", "--disable-3d-apis"]),
  ],
});
const browser = await chromium.connect(server.wsEndpoint());
const AXE = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const LONG = 120000;
let page, tools, errors;
const others = [];

async function leave() {
  await page?.context().close();
  page = undefined;
}

/** A tab of its own, without the cookies of the one before. */
async function fresh({ width = 1280, height = 800, scheme = "light", touch = false, forced = false } = {}) {
  await leave();
  const context = await browser.newContext({
    viewport: { width, height }, colorScheme: scheme, hasTouch: touch, isMobile: touch, ignoreHTTPSErrors: true,
    forcedColors: forced ? "active" : "none",
  });
  context.setDefaultTimeout(LONG);
  page = await context.newPage();
  errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  page.on("console", (message) => {
    if (message.text().includes("Content Security Policy")) errors.push(message.text());
  });
  await page.addInitScript(() => {
    window.sockets = [];
    const Real = window.WebSocket;
    window.WebSocket = class extends Real {
      constructor(...args) {
        super(...args);
        window.sockets.push(this);
      }
    };
    window.pad = null;
    navigator.getGamepads = () => [window.pad];
  });
  tools = await context.newCDPSession(page);
}

async function load(url, selector) {
  for (let tries = 0; ; tries++) {
    try {
      await page.goto(url);
      break;
    } catch (error) {
      if (tries > 300) throw error;
      await new Promise((resolve) => setTimeout(resolve, 500));
    }
  }
  await page.waitForSelector(selector);
}

const doing = {
  fresh,
  leave,
  /** A second tab, of a browser that shares nothing with the first; afterwards it is the one. */
  second: async ({ url }) => {
    others.push(page);
    page = undefined;
    await fresh();
    await load(url, ".state[data-state='running']");
  },
  /** Back to the tab before. */
  back: async () => {
    await page.context().close();
    page = others.pop();
  },
  open: ({ url }) => load(url, ".state[data-state='running']"),
  visit: ({ url, selector }) => load(url, selector),
  take: async () => {
    const button = page.getByRole("button", { name: "Take control" });
    if (await button.count()) await button.click();
    await page.locator(".owner.you, dialog").first().waitFor();
    const dialog = page.getByRole("dialog");
    if (await dialog.count()) await dialog.getByRole("button", { name: "Take over" }).click();
    await page.locator(".owner.you").waitFor();
  },
  view: async ({ name }) => {
    await page.getByRole("link", { name }).click();
    await page.waitForSelector(`main[data-view='${name.toLowerCase()}']`);
  },
  down: ({ key }) => page.keyboard.down(key),
  up: ({ key }) => page.keyboard.up(key),
  press: async ({ key, times = 1 }) => {
    for (let i = 0; i < times; i++) await page.keyboard.press(key);
  },
  /** Press Tab until a control of that name has the focus. */
  to: async ({ name }) => {
    for (let i = 0; i < 200; i++) {
      await page.keyboard.press("Tab");
      if ((await doing.focused()).includes(name)) return;
    }
    throw new Error(`the tab key does not reach '${name}'`);
  },
  type: ({ text }) => page.keyboard.type(text),
  fill: ({ label, text }) => page.getByLabel(label).first().fill(text),
  click: ({ role, name }) => page.getByRole(role, { name }).first().click(),
  wait: async ({ selector, text }) => {
    await page.locator(selector).filter({ hasText: text ?? "" }).first().waitFor();
  },
  stage: async () => (await page.locator(".stage.plain").waitFor(), true),
  text: ({ selector }) => page.locator(selector).first().innerText(),
  framed: ({ selector }) => page.frameLocator("iframe").locator(selector).first().innerText(),
  run: ({ script }) => page.evaluate(script),
  focused: () => page.evaluate(() => {
    const at = document.activeElement;
    if (!at.matches("a, button, input, select, textarea")) return "";
    return at.getAttribute("aria-label") || at.labels?.[0]?.innerText || at.innerText || at.tagName;
  }),
  /** Draw fingers over an element: each from one place to another, as shares of its width. */
  fingers: async ({ selector, begin, end }) => {
    const target = page.locator(selector).first();
    await target.scrollIntoViewIfNeeded();
    const { x, y, width, height } = await target.boundingBox();
    const points = (part) => begin.map((start, id) => ({ id, x: x + width * (start + part * (end[id] - start)), y: y + height / 2 }));
    const send = (type, touchPoints) => tools.send("Input.dispatchTouchEvent", { type, touchPoints });
    await send("touchStart", points(0));
    for (let part = 0.1; part < 1.05; part += 0.1) await send("touchMove", points(part));
    await send("touchEnd", []);
  },
  /** Take hold of an element with the mouse, draw it by shares of its width, and keep hold. */
  grab: async ({ selector, dx = 0, dy = 0 }) => {
    const { x, y, width, height } = await page.locator(selector).first().boundingBox();
    await page.mouse.move(x + width / 2, y + height / 2);
    await page.mouse.down();
    await page.mouse.move(x + width * (0.5 + dx), y + height * 0.5 + width * dy, { steps: 3 });
  },
  /** Draw the held mouse on. */
  drag: async ({ selector, dx = 0, dy = 0 }) => {
    const { x, y, width, height } = await page.locator(selector).first().boundingBox();
    await page.mouse.move(x + width * (0.5 + dx), y + height * 0.5 + width * dy, { steps: 3 });
  },
  drop: () => page.mouse.up(),
  /** Turn the wheel over an element, at a share of its width. */
  wheel: async ({ selector, at = 0.5, dy }) => {
    const { x, y, width, height } = await page.locator(selector).first().boundingBox();
    await page.mouse.move(x + width * at, y + height / 2);
    await page.mouse.wheel(0, dy);
  },
  /** Mark a stretch of an element with the mouse, from one share of its width to another. */
  mark: async ({ selector, begin, end }) => {
    const { x, y, width, height } = await page.locator(selector).first().boundingBox();
    await page.mouse.move(x + width * begin, y + height / 2);
    await page.mouse.down();
    await page.mouse.move(x + width * end, y + height / 2, { steps: 5 });
    await page.mouse.up();
  },
  cut: () => page.evaluate(() => window.sockets.forEach((socket) => socket.close())),
  mute: () => page.evaluate(() => window.sockets.forEach((socket) => (socket.send = () => {}))),
  freeze: async () => {
    await tools.send("Debugger.enable");
    await tools.send("Debugger.pause");
  },
  thaw: () => tools.send("Debugger.disable"),
  rest: ({ ms }) => page.waitForTimeout(ms),
  /** Wait until the page has looked at the gamepad: every 50 ms, if the computer lets it. */
  looked: () => page.evaluate(() => new Promise((done) => {
    let times = 0;
    const timer = setInterval(() => ++times === 4 && done(clearInterval(timer)), 50);
  })),
  pid: () => server.process().pid,
  errors: () => errors,
  shot: async ({ path }) => {
    const format = extname(path).slice(1);
    const { data } = await tools.send("Page.captureScreenshot", { format, ...(format !== "png" && { quality: 70 }) });
    writeFileSync(path, Buffer.from(data, "base64"));
  },
  /** Faults of accessibility of a picture that is new: what a busy computer makes old is dimmed. */
  axe: async () => {
    await tools.send("Page.setBypassCSP", { enabled: true });
    if (!(await page.evaluate(() => "axe" in window))) await page.evaluate(AXE);
    for (let tries = 0; ; tries++) {
      const { violations, wasOld } = await page.evaluate(async () => {
        const isOld = () => document.body.classList.contains("stale");
        let wasOld = isOld();
        const watch = new MutationObserver(() => (wasOld ||= isOld()));
        watch.observe(document.body, { attributeFilter: ["class"] });
        const { violations } = await window.axe.run({ resultTypes: ["violations"] });
        watch.disconnect();
        return { violations, wasOld };
      });
      if (violations.length && wasOld && tries < 30) continue;
      return violations.map((v) => `${v.id}: ${v.nodes.slice(0, 3).map((n) => `${n.target} ${n.failureSummary}`).join("; ")}`);
    }
  },
};

console.log(JSON.stringify({ ready: true }));
for await (const line of readline.createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  try {
    console.log(JSON.stringify({ result: (await doing[request.do](request)) ?? null }));
  } catch (error) {
    console.log(JSON.stringify({ error: error.message.split("\n").slice(0, 3).join(" ") }));
  }
}
await browser.close();
await server.close();
