// A real browser that does what it is asked, one JSON line at a time.
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
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
const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
const errors = [];
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
});
const tools = await page.context().newCDPSession(page);

const doing = {
  open: async ({ url }) => {
    for (let tries = 0; ; tries++) {
      try {
        await page.goto(url);
        break;
      } catch (error) {
        if (tries > 40) throw error;
        await new Promise((resolve) => setTimeout(resolve, 500));
      }
    }
    await page.waitForSelector(".state[data-state='running']", { timeout: 60000 });
  },
  take: async () => {
    if (await page.getByRole("button", { name: "Take control" }).count()) {
      await page.getByRole("button", { name: "Take control" }).click();
    }
    await page.getByText("You drive").waitFor({ timeout: 20000 });
  },
  view: async ({ name }) => {
    await page.getByRole("link", { name }).click();
    await page.waitForSelector(`main[data-view='${name.toLowerCase()}']`);
  },
  down: async ({ key }) => page.keyboard.down(key),
  up: async ({ key }) => page.keyboard.up(key),
  press: async ({ key }) => page.keyboard.press(key),
  click: async ({ role, name }) => page.getByRole(role, { name }).first().click(),
  stage: async () => (await page.locator(".stage.plain").waitFor({ timeout: 30000 }), true),
  text: async ({ selector }) => page.locator(selector).first().innerText(),
  cut: async () => page.evaluate(() => window.sockets.forEach((socket) => socket.close())),
  mute: async () => page.evaluate(() => window.sockets.forEach((socket) => (socket.send = () => {}))),
  freeze: async () => {
    await tools.send("Debugger.enable");
    await tools.send("Debugger.pause");
  },
  thaw: async () => tools.send("Debugger.disable"),
  pid: async () => server.process().pid,
  errors: async () => errors,
  shot: async ({ path }) => (await page.screenshot({ path }), true),
  axe: async () => {
    await tools.send("Page.setBypassCSP", { enabled: true });
    await page.evaluate(readFileSync(require.resolve("axe-core/axe.min.js"), "utf8"));
    const { violations } = await page.evaluate(() => window.axe.run());
    return violations
      .filter((v) => ["serious", "critical"].includes(v.impact))
      .map((v) => `${v.id}: ${v.nodes.slice(0, 3).map((n) => `${n.target} ${n.failureSummary}`).join("; ")}`);
  },
};

console.log(JSON.stringify({ ready: true }));
for await (const line of readline.createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  try {
    console.log(JSON.stringify({ result: (await doing[request.do](request)) ?? null }));
  } catch (error) {
    console.log(JSON.stringify({ error: error.message.split("\n")[0] }));
  }
}
await browser.close();
await server.close();
