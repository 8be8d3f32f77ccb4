import { createHash } from "node:crypto";
import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";

const SOURCES = ["src", "public", "index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.js"];
const SHIPPED = ["three", "uplot"];

function filesIn(path) {
  if (!statSync(path).isDirectory()) return [path];
  return readdirSync(path).sort().flatMap((name) => filesIn(`${path}/${name}`));
}

/** What the bundle was built from, and under which licences: both stand beside it. */
function provenance() {
  let out = "";
  return {
    name: "provenance",
    configResolved: (config) => void (out = config.build.outDir),
    closeBundle() {
      const hash = createHash("sha256");
      for (const file of SOURCES.flatMap(filesIn)) hash.update(`${file}\n`).update(readFileSync(file)).update("\n");
      writeFileSync(join(out, "source.sha256"), hash.digest("hex") + "\n");
      const licences = SHIPPED.map((name) => {
        const folder = `node_modules/${name}`;
        const { version } = JSON.parse(readFileSync(`${folder}/package.json`, "utf8"));
        return `${name} ${version}\n\n${readFileSync(`${folder}/LICENSE`, "utf8").trim()}\n`;
      });
      writeFileSync(join(out, "licences.txt"), licences.join("\n---\n\n"));
    },
  };
}

export default defineConfig({
  base: "./",
  plugins: [provenance()],
  build: {
    outDir: "../hilserver/io/page/static",
    emptyOutDir: true,
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 800,
    target: "es2022",
  },
  server: { proxy: { "/api": { target: "http://127.0.0.1:8080", ws: true } } },
});
