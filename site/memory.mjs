// @ts-check
/** Prints the memory of the pages for playing and inspecting over many changes of the scene, which must not grow: memory.mjs. */
import { fileURLToPath } from "node:url";
import { launch, serve } from "./tests/browser.mjs";

const CHANGES = 300, EVERY = 100, MOST = 1.1;  // the last measurement in relation to the first one after EVERY changes
const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)));
let isLevel = true;
for (const path of ["play/", "play/inspect.html"]) {
  const browser = await launch(), page = await browser.context.newPage(), session = await browser.context.newCDPSession(page);
  await page.setViewportSize({ width: 300, height: 400 });
  await page.addInitScript(() => {
    const { instantiate } = WebAssembly;
    WebAssembly.instantiate = /** @type {any} */ (async (/** @type {any[]} */ ...given) => {
      const instance = await /** @type {any} */ (instantiate)(...given);
      Object.assign(window, { memory: Object.values(instance.exports).find((one) => one instanceof WebAssembly.Memory) });
      return instance;
    });
  });
  await page.goto(`${site.address}${path}#MoveToCorner-Demo-0`);
  const { environments } = await page.evaluate(async () => (await fetch("catalogue.json")).json());
  const names = environments.filter((/** @type {any} */ { variant }) => variant !== "Demo").map((/** @type {any} */ { task, variant }) => `${task}-${variant}`);
  /** @type {{javascript: number, wasm: number}[]} MB */
  const sizes = [];
  for (let i = 0; i <= CHANGES; i++) {
    const name = `${names[i % 10 * 5]}-${i % 20}`;
    await page.evaluate((hash) => { location.hash = hash; }, name);
    await page.waitForFunction((name) => document.getElementById("message") ? document.title.startsWith(`${name} `) && !document.getElementById("message")?.textContent
      : document.getElementById("inspect")?.getAttribute("href")?.endsWith(`#${name}`) && document.getElementById("status")?.textContent?.startsWith("Press"), name);
    if (i % EVERY) continue;
    await session.send("HeapProfiler.collectGarbage");
    const { usedSize } = await session.send("Runtime.getHeapUsage");
    const wasm = Number(await page.evaluate("memory.buffer.byteLength"));
    sizes.push({ javascript: usedSize / 1e6, wasm: wasm / 1e6 });
  }
  for (const kind of /** @type {const} */ (["javascript", "wasm"])) {
    console.log(`${path} ${kind}: ${sizes.map((size, i) => `${(size[kind]).toFixed(1)} MB after ${i * EVERY}`).join(", ")} changes`);
    isLevel &&= sizes[sizes.length - 1][kind] <= MOST * sizes[1][kind];
  }
  await browser.close();
}
site.close();
if (!isLevel) throw new Error(`the memory grows by more than ${(100 * (MOST - 1)).toFixed(0)} %`);
