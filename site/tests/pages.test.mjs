// @ts-check
/** The documentation pages: accessibility, sorting, filters, animations and charts. */
import assert from "node:assert/strict";
import { fileURLToPath } from "node:url";
import { after, before, test } from "node:test";
import { barriers, launch, PAGES, serve } from "./browser.mjs";

const OUT = fileURLToPath(new URL("../../out/", import.meta.url));
/** @type {Awaited<ReturnType<typeof serve>>} */
let site;
/** @type {Awaited<ReturnType<typeof launch>>} */
let browser;
/** @type {import("playwright-core").Page} */
let page;

before(async () => {
  site = await serve(`${OUT}site`);
  browser = await launch();
  page = await browser.context.newPage();
});
after(async () => {
  await browser.close();
  site.close();
});

test("axe finds no accessibility problems, and no page is wider than a phone", async () => {
  await page.setViewportSize({ width: 375, height: 800 });
  for (const path of PAGES) {
    await page.goto("about:blank");
    await page.goto(site.address + path);
    if (path.startsWith("play")) await page.waitForFunction(() => !document.querySelector("[role=status]")?.textContent?.endsWith("…"));
    assert.ok(Number(await page.evaluate("document.documentElement.scrollWidth")) <= 375, path);
    assert.deepEqual(await barriers(page), [], path);
  }
  await page.setViewportSize({ width: 1280, height: 800 });
});

test("the gallery animates cards, filters them, and links to the page for playing", async () => {
  await page.goto(`${site.address}gallery.html#axis=colour`);
  const shown = page.locator(".gallery .card:visible");
  assert.equal(await shown.count(), 22);
  await page.selectOption("[name=task]", "FixColour");
  assert.deepEqual(await shown.locator("strong").allTextContents(), ["Colour", "CountPlus", "All"].map((variant) => `FixColour-${variant}`));
  assert.match(page.url(), /#task=FixColour&axis=colour$/);
  const still = await shown.last().locator("img").getAttribute("src");
  await shown.last().hover();
  await page.waitForFunction(() => document.querySelector("img[src$='FixColour-All.webp']"));
  await page.mouse.move(0, 0);
  await page.waitForFunction((still) => document.querySelector(`img[src$="${still}"]`), still);
  await shown.last().getByText("Play").click();
  await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Press"));
  assert.equal(await page.evaluate("location.hash"), "#FixColour-All-0");
});

test("the gallery links shifted scenes and other bodies to the pages for playing and inspecting", async () => {
  for (const [name, address] of [["FindDupe with clutter", "FindDupe-Demo-0?shifts=clutter:4"], ["the longstick", "SweepToTop-Layout-0?shifts=body:longstick"]]) {
    await page.goto(`${site.address}gallery.html`);
    await page.getByLabel(`Inspect ${name}`, { exact: true }).click();
    await page.waitForFunction((address) => document.title.startsWith(`${address} `), address);
    await page.goto(`${site.address}gallery.html`);
    await page.getByLabel(`Play ${name}`, { exact: true }).click();
    await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Press"));
    assert.equal(await page.evaluate("location.hash"), `#${address}`);
  }
});

test("charts show their figures, and the leaderboard sorts, opens rows, and links to replays", async () => {
  await page.goto(`${site.address}index.html`);
  const layout = page.locator(".column", { hasText: "Layout" });
  await layout.focus();
  assert.match(await layout.locator(".figures").innerText(), /Goals and planning 0\.\d\d[^]*BC from states 0\.\d\d/);
  await page.locator(".chart label", { hasText: "BC from states" }).click();
  await layout.focus();
  assert.doesNotMatch(await layout.locator(".figures").innerText(), /BC from states/);
  await page.goto(`${site.address}standings.html`);
  const table = page.locator("table.standings").first();
  await table.getByRole("button", { name: "Demo", exact: true }).click();
  const demo = (await table.locator(":scope > tbody > tr:first-child > td:nth-child(5)").allTextContents()).map((text) => Number.parseFloat(text) || 0);
  assert.deepEqual(demo, [...demo].sort((one, other) => other - one));
  await table.locator("button.opens").first().click();
  await table.locator(".heat a").first().click();
  await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Watching"));
});

test("a second visit needs no network", async () => {
  const other = await serve(`${OUT}site`), keeping = await launch({ keeps: true });
  try {
    const visit = await keeping.context.newPage();
    const until = (/** @type {string} */ text) => visit.waitForFunction((text) => document.getElementById("status")?.textContent?.startsWith(text), text);
    await visit.goto(`${other.address}play/?speed=40#FindDupe-All-3`);
    await until("Press");
    await visit.waitForFunction(() => navigator.serviceWorker.controller);
    other.close();
    await visit.reload();
    await until("Press");
    await visit.selectOption("#task", "MakeLine");
    await visit.waitForFunction(() => location.hash.startsWith("#MakeLine"));
    await until("Press");
    await visit.keyboard.press("h");
    await until("Over: score 1.00");
  } finally {
    await keeping.close();
    other.close();
  }
});
