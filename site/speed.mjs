// @ts-check
/** Measures loading times, sizes and frame rates of the built site's pages, with a compressing server: node site/speed.mjs. */
import { fileURLToPath } from "node:url";
import { launch, serve } from "./tests/browser.mjs";

const SLOW = { offline: false, latency: 150, downloadThroughput: 1.6e6 / 8, uploadThroughput: 0.75e6 / 8 };  // 1.6 Mbit/s
const SECONDS = 4;
const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)), { compress: true });
const PLAY = { path: "play/#FindDupe-All-8", ready: () => document.getElementById("status")?.textContent?.startsWith("Press") };
const INSPECT = { path: "play/inspect.html#FindDupe-All-3", ready: () => document.title.startsWith("FindDupe-All-3 ") };

/**
 * Opens a page for the first time. Returns its size, the times of the first paint and of readiness, and the frame rate while driving.
 * @param {{path: string, ready: () => boolean | undefined}} what
 * @param {boolean} isSlow  whether by 1.6 Mbit/s
 */
async function measured({ path, ready }, isSlow) {
  const browser = await launch(), page = await browser.context.newPage(), session = await browser.context.newCDPSession(page);
  await page.setViewportSize({ width: 1280, height: 800 });
  let bytes = 0;
  session.on("Network.loadingFinished", ({ encodedDataLength }) => { bytes += encodedDataLength; });
  await session.send("Network.enable");
  if (isSlow) await session.send("Network.emulateNetworkConditions", SLOW);
  await page.goto(site.address + path, { waitUntil: "commit" });
  await page.waitForFunction(ready, null, { polling: 50 });
  const readyAt = Number(await page.evaluate("performance.now()"));
  const painted = Number(await page.evaluate("performance.getEntriesByName('first-contentful-paint')[0]?.startTime"));
  await page.focus("#solids, #arena");
  await page.keyboard.down("ArrowUp");
  await page.waitForTimeout(1500);
  const rate = await page.evaluate((seconds) => new Promise((resolve) => {
    let count = 0;
    const start = performance.now(), next = () => {
      count += 1;
      if (performance.now() < start + 1000 * seconds) requestAnimationFrame(next);
      else resolve(1000 * count / (performance.now() - start));
    };
    requestAnimationFrame(next);
  }), SECONDS);
  await browser.close();
  return `${(painted / 1000).toFixed(1)} s | ${(readyAt / 1000).toFixed(1)} s | ${(bytes / 1e6).toFixed(1)} MB | ${Number(rate).toFixed(0)}`;
}

console.log("page, connection | first paint | ready | loaded | frames/s at 1280 x 800, drawn by software");
for (const [name, what] of Object.entries({ play: PLAY, inspect: INSPECT })) {
  for (const isSlow of [false, true]) console.log(`${name}, ${isSlow ? "1.6 Mbit/s" : "local"} | ${await measured(what, isSlow)}`);
}
site.close();
