// @ts-check
/** Pictures of the built site, for the documentation: node site/screenshots.mjs FOLDER. */
import { fileURLToPath } from "node:url";
import { launch, serve } from "./tests/browser.mjs";

const site = await serve(fileURLToPath(new URL("../out/site", import.meta.url)));
const browser = await launch();
const page = await browser.context.newPage();
const shots = { home: ["index.html", 1000, 700], task: ["FindDupe.html", 1000, 700], play: ["play/#FindDupe-All-8", 1000, 700],
  phone: ["play/#FindDupe-All-8", 390, 700] };
for (const [name, [path, width, height]] of Object.entries(shots)) {
  await page.setViewportSize({ width: Number(width), height: Number(height) });
  await page.goto("about:blank");
  await page.goto(`${site.address}${path}`);
  if (String(path).startsWith("play")) {
    await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Press"));
    await page.keyboard.press("h");
    await page.waitForTimeout(4000);
  } else await page.waitForTimeout(4000);
  await page.screenshot({ path: `${process.argv[2]}/${name}.png` });
}
await browser.close();
site.close();
