// @ts-check
/** Writes pictures of the site on a phone, a desktop and a large screen, light and dark, for visual checks: node site/looks.mjs FOLDER [PAGE ...]. */
import { spawn } from "node:child_process";
import { mkdir, mkdtemp, readFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { launch, serve } from "./tests/browser.mjs";

const [folder, ...wanted] = process.argv.slice(2);
const SIZES = [[375, 812], [1280, 800], [2560, 1440]];
/** @type {Record<string, string>} */
const PAGES = { home: "index.html", gallery: "gallery.html", task: "FindDupe.html", results: "standings.html",
  play: "play/#FindDupe-Demo-0?shifts=clutter:3", inspect: "play/inspect.html#FindDupe-All-3" };

const study = await mkdtemp(join(tmpdir(), "magical-looks-")), python = fileURLToPath(new URL("../.venv/bin/python", import.meta.url));
const server = spawn(python, ["-m", "magical_mj", "collect", study, "--port", "0", "--tasks", "MoveToRegion,FindDupe", "--wanted", "20"]);
const { value: seat } = await createInterface(server.stdout)[Symbol.asyncIterator]().next();
const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)));
const addresses = Object.fromEntries(Object.entries(PAGES).map(([name, path]) => [name, site.address + path]));
addresses.operator = seat.replace(/[^/]+\/$/, `${await readFile(join(study, "operator"), "utf8")}/operator.html`);

await mkdir(folder, { recursive: true });
const browser = await launch(), page = await browser.context.newPage();
for (const name of wanted.length ? wanted : Object.keys(addresses)) {
  for (const colorScheme of /** @type {const} */ (["light", "dark"])) {
    for (const [width, height] of SIZES) {
      await page.setViewportSize({ width, height });
      await page.emulateMedia({ colorScheme });
      await page.goto("about:blank");
      await page.goto(addresses[name]);
      await page.waitForFunction(() => !document.querySelector("[role=status]")?.textContent?.endsWith("…"));
      await page.waitForTimeout(2500);  // for late drawing and loading
      await page.screenshot({ path: join(folder, `${name}-${width}-${colorScheme}.png`) });
    }
  }
}
await browser.close();
site.close();
server.kill();
