// @ts-check
/** Writes pictures of the built site for the documentation: node site/screenshots.mjs FOLDER. */
import { fileURLToPath } from "node:url";
import { launch, serve } from "./tests/browser.mjs";

const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)));
const browser = await launch();
const page = await browser.context.newPage();
const shots = { home: ["index.html", 1000, 700], task: ["FindDupe.html", 1000, 700], play: ["play/?speed=20#FindDupe-Layout-2@state-bc", 1000, 780],
  phone: ["play/#FindDupe-All-8", 390, 700], gallery: ["gallery.html", 610, 700], inspect: ["play/inspect.html#FindDupe-All-3", 1280, 800] };
for (const [name, [path, width, height]] of Object.entries(shots)) {
  await page.setViewportSize({ width: Number(width), height: Number(height) });
  await page.goto("about:blank");
  await page.goto(`${site.address}${path}`);
  if (name === "inspect") {
    await page.waitForFunction(() => document.title.startsWith("FindDupe-All-3 ") && !document.getElementById("poster"));
    for (const shown of ["contacts", "joints"]) await page.check(`[name=${shown}]`);
    await page.locator("#tree button", { hasText: "robot" }).first().click();
    await page.click("#expert");
    await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 4);
    await page.keyboard.press("p");
    await page.waitForTimeout(2000);  // until it is drawn in full quality
  } else if (name === "play") {  // the end of a failed episode
    await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Over"));
  } else if (name === "phone") {
    await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Press"));
    await page.keyboard.press("h");
    await page.waitForTimeout(4000);
  } else await page.waitForTimeout(4000);
  await page.screenshot({ path: `${process.argv[2]}/${name}.png` });
}
await browser.close();
site.close();
