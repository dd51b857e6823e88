// @ts-check
/** Tests the editor of scenes in play and inspect. It writes what it saves to out/site-test/edited.json, which saved.py compares with Python. */
import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import { after, before, test } from "node:test";
import { barriers, downloaded } from "./browser.mjs";
import { OUT, browser, complaints, page, site } from "./opened.mjs";

/** @type {{scene: string, model: string, link: string, blocks: any[], returned: string[][]}} what Python reads */
const saved = { scene: "", model: "", link: "", blocks: [], returned: [] };

before(async () => {
  await page.setViewportSize({ width: 1000, height: 700 });
});
after(async () => {
  await writeFile(`${OUT}site-test/edited.json`, JSON.stringify(saved));
});

const verdict = () => page.textContent("#editor .verdict");
/** @param {string} name */
const handle = (name) => page.locator(`#editor [data-object="${name}"]`);
/** @param {string} text */
const button = (text) => page.locator("#editor button", { hasText: text });
const status = () => page.textContent("#status");
/** The scene that would be saved. The focus stays. */
async function sceneNow() {
  const focused = await page.evaluate(() => document.activeElement?.getAttribute("data-object"));
  const { text } = await downloaded(page, "#save-scene");
  if (focused) await handle(focused).focus();
  return JSON.parse(text);
}
/** @param {string} name */
async function openEditor(name) {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/#${name}`);
  await ready();
  await page.click("#edit");
  await page.waitForSelector("#editor");
}
const ready = () => page.waitForFunction(() => /^(Press|No score)/.test(document.getElementById("status")?.textContent ?? ""));
/** Drags from the middle of an element. @param {import("playwright-core").Locator} what @param {number} dx  pixels @param {number} dy */
async function drag(what, dx, dy) {
  const box = /** @type {any} */ (await what.boundingBox()), [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + dx / 2, y + dy / 2);
  await page.mouse.move(x + dx, y + dy);
  await page.mouse.up();
}

test("by mouse: objects are moved, regions get another size, illegal places glow, the score is live, all of it can be undone", async () => {
  await openEditor("MoveToCorner-Demo-0");
  const first = await sceneNow(), { width } = /** @type {any} */ (await page.locator("#editor .board").boundingBox()), unit = width / 2.04;
  const [{ x, y }] = first.blocks;
  assert.match(await verdict() ?? "", /^This scene is legal. Score at the start: 0.00/);
  await drag(handle("block 0"), (-0.6 - x) * unit, (y - 0.7) * unit);
  const moved = (await sceneNow()).blocks[0];
  assert.ok(Math.hypot(moved.x + 0.6, moved.y - 0.7) < 0.02, JSON.stringify(moved));
  assert.match(await verdict() ?? "", /Score at the start: 1.00/);
  const robot = first.robot;
  await drag(handle("robot"), (moved.x - robot.x) * unit, (robot.y - moved.y) * unit);
  assert.match(await verdict() ?? "", /^The robot and block 1 overlap/);
  assert.deepEqual(await page.$$eval("#editor .wrong.handle", (all) => all.map((one) => /** @type {HTMLElement} */ (one).dataset.object)), ["block 0", "robot"]);
  const glow = await handle("robot").evaluate((one) => getComputedStyle(one).boxShadow);
  assert.match(glow, /rgb\(231, 76, 60\)/);
  assert.ok(await button("Play it").isDisabled() && await button("Save model").isDisabled());
  await button("Undo").click();
  await button("Undo").click();
  assert.deepEqual(await sceneNow(), first);
  await button("Redo").click();
  assert.deepEqual((await sceneNow()).blocks[0], moved);
  await page.locator("#editor button", { hasText: "+ Region" }).click();
  const [added] = (await sceneNow()).regions;
  await drag(page.locator("#editor .region .corner.x_max.y_max"), 0.1 * unit, -0.2 * unit);
  const [larger] = (await sceneNow()).regions;
  assert.deepEqual([larger.x_min, larger.y_min], [added.x_min, added.y_min]);
  assert.ok(Math.abs(larger.x_max - added.x_max - 0.1) < 0.02 && Math.abs(larger.y_max - added.y_max - 0.2) < 0.02);
  assert.match(await verdict() ?? "", /No score: MoveToCorner needs no goal regions, but this has 1/);
  await handle("block 0").focus();
  await page.keyboard.press("Delete");
  await button("Play it").click();
  await page.waitForFunction(() => document.getElementById("status")?.textContent === "No score: MoveToCorner needs exactly one block, but this has 0");
  await page.waitForFunction(() => document.getElementById("score")?.textContent === "–");
  await page.keyboard.press("ArrowUp");
  await page.waitForFunction(() => document.getElementById("status")?.textContent === "Playing");
  assert.deepEqual(complaints, []);
});

test("by keyboard: Tab selects, keys move, turn, resize and remove, fields take exact numbers; the saved scene, model and link are one scene", async () => {
  await openEditor("MatchRegions-Demo-0");
  const first = await sceneNow();
  assert.ok(await handle("robot").evaluate((one) => one === document.activeElement), "the robot is selected first");
  for (let i = 0; i < first.blocks.length; i++) await page.keyboard.press("Shift+Tab");
  assert.equal(await page.evaluate(() => document.activeElement?.getAttribute("data-object")), "block 0");
  for (const key of ["ArrowRight", "ArrowRight", "Shift+ArrowUp", "r", "r", "Shift+R"]) await page.keyboard.press(key);
  const [block] = (await sceneNow()).blocks, three = (/** @type {number} */ value) => Math.round(1000 * value) / 1000, from = first.blocks[0];
  assert.deepEqual([block.x, block.y, block.angle], [three(three(from.x + 0.02) + 0.02), three(from.y + 0.002), three(from.angle + Math.PI / 12)].map(
    (value, i) => i === 2 ? block.angle : value));
  assert.ok(Math.abs(block.angle - from.angle - Math.PI / 12) < 0.003);
  await page.keyboard.press("Delete");
  assert.equal((await sceneNow()).blocks.length, first.blocks.length - 1);
  await page.keyboard.press("Control+z");
  await handle("region 0").focus();
  await page.keyboard.press("-");
  assert.equal((await sceneNow()).regions[0].x_max, three(first.regions[0].x_max - 0.02));
  await page.selectOption("#editor [name=colour]", "green");
  await page.fill("#editor [name=x_min]", "-0.1234567890123456");
  await page.keyboard.press("Tab");
  await page.fill("#editor [name=y_min]", "0.99");  // above y_max
  await page.keyboard.press("Tab");
  assert.match(await verdict() ?? "", /A region needs x_min < x_max/);
  await button("+ Block").click();
  await page.selectOption("#editor [name=shape]", "star");
  const scene = await sceneNow();
  assert.equal(scene.regions[0].x_min, -0.1234567890123456);
  assert.equal(scene.regions[0].y_min, first.regions[0].y_min);
  assert.equal(scene.regions[0].colour, "green");
  assert.deepEqual({ ...scene.blocks.at(-1), x: 0, y: 0 }, { shape: "star", colour: "red", x: 0, y: 0, angle: 0 });
  assert.deepEqual(scene.blocks.slice(1, -1), first.blocks.slice(1), "what nobody changed keeps all digits");
  await handle(`block ${scene.blocks.length - 1}`).focus();
  await page.selectOption("#editor [name=colour]", "green");
  assert.match(await verdict() ?? "", /Score at the start: /);
  saved.scene = (await downloaded(page, "#save-scene")).text;
  saved.model = (await downloaded(page, "#save-model")).text;
  saved.blocks = JSON.parse(saved.scene).blocks;
  assert.deepEqual(complaints, []);
  assert.deepEqual(await barriers(page), []);
  complaints.length = 0;  // those about axe's styles
  await button("Play it").click();
  await page.waitForFunction(() => location.hash.includes("?scene="));
  await ready();
  saved.link = page.url();
  assert.match(saved.link, /#MatchRegions-Demo-0\?scene=/);
  assert.ok(await page.isDisabled("#save"), "recordings of seeds only");
  await page.keyboard.press("ArrowUp");
  await page.waitForFunction(() => document.getElementById("status")?.textContent === "Playing");
  await page.keyboard.press("r");
  await ready();
  assert.equal(page.url(), saved.link, "again: the same scene");
  await page.click("#inspect");
  await page.waitForFunction(() => document.title.startsWith("MatchRegions-edited ") && document.getElementById("message")?.textContent === "");
  await page.click("#edit");
  await page.waitForSelector("#editor");
  assert.deepEqual(await sceneNow(), JSON.parse(saved.scene), "in inspect too");
  await handle("block 0").focus();
  await page.keyboard.press("ArrowLeft");
  const before = page.url();
  await button("Inspect it").click();
  await page.waitForFunction((before) => location.href !== before && document.getElementById("message")?.textContent === "", before);
  await page.click("#step");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0);
  assert.deepEqual(complaints, []);
});

test("scenes from Python open and come back, in play and inspect", async () => {
  /** @type {{scene: string, fault: string | null}[]} */
  const cases = JSON.parse(await readFile(`${OUT}site-test/edits.json`, "utf8"));
  await openEditor("FindDupe-Demo-0");
  for (const { scene } of cases.filter((_, i) => i % 150 === 0)) {  // Chromium allows ten downloads in quick succession
    await page.setInputFiles("#editor input[type=file]", { name: "scene.json", mimeType: "application/json", buffer: Buffer.from(scene) });
    await page.waitForFunction(() => /** @type {HTMLInputElement} */ (document.querySelector("#editor input[type=file]")).files?.length === 0);  // it was read
    saved.returned.push([scene, (await downloaded(page, "#save-scene")).text]);
  }
  await page.setInputFiles("#editor input[type=file]", { name: "bad.json", mimeType: "application/json", buffer: Buffer.from('{"format": 1, "robot": {}}') });
  await page.waitForFunction(() => document.querySelector("#editor .verdict")?.textContent?.startsWith("bad.json cannot be opened. robot lacks the field x"));
  page.once("dialog", (dialog) => dialog.accept());
  await button("Cancel").click();
  await page.waitForSelector("#editor", { state: "detached" });
  assert.equal(new URL(page.url()).hash, "#FindDupe-Demo-0");
  const { scene } = /** @type {any} */ (cases.find((one) => one.fault === null && one.scene.includes("longstick")));
  await page.goto(`${site.address}play/inspect.html#SweepToTop-Demo-0`);
  await page.waitForFunction(() => document.title.startsWith("SweepToTop"));
  await page.setInputFiles("#file", { name: "scene.json", mimeType: "application/json", buffer: Buffer.from(scene) });
  await page.waitForFunction(() => document.title.startsWith("SweepToTop-edited") && document.getElementById("message")?.textContent === "");
  await page.click("#edit");
  await page.waitForSelector("#editor");
  saved.returned.push([scene, (await downloaded(page, "#save-scene")).text]);
  assert.deepEqual(complaints, []);
});

test("if the editor cannot be loaded, the page says so and goes on", async () => {
  for (const [path, spot] of [["play/", "#status"], ["play/inspect.html", "#message"]]) {
    await page.goto("about:blank");
    await page.route("**/editor.js", (route) => route.abort());
    await page.goto(`${site.address}${path}#MoveToCorner-Demo-0`);
    await page.waitForFunction((spot) => /^(Press.*|)$/.test(document.querySelector(spot)?.textContent ?? "-"), spot);
    await page.click("#edit");
    await page.waitForFunction((spot) => document.querySelector(spot)?.textContent?.includes("The editor could not be loaded"), spot);
    await page.unroute("**/editor.js");
    await page.selectOption("#task", "MoveToRegion");
    await page.waitForFunction(() => location.hash === "#MoveToRegion-Demo-0");
  }
  complaints.length = 0;  // those about the request
});

test("a bad link says what is wrong, and another scene can be chosen", async () => {
  for (const [path, spot] of [["play/", "#status"], ["play/inspect.html", "#message"]]) {
    await page.goto("about:blank");
    await page.goto(`${site.address}${path}#MoveToCorner-Demo-0?scene=%7B%22format%22:1%7D`);
    await page.waitForFunction((spot) => document.querySelector(spot)?.textContent?.includes("scene lacks the field robot"), spot);
    await page.selectOption("#task", "MoveToRegion");
    await page.waitForFunction(() => location.hash === "#MoveToRegion-Demo-0");
  }
  assert.deepEqual(complaints, []);
});

test("by touch, on a phone: a block follows the finger, and the page stays", { skip: process.env.BROWSER === "firefox" }, async () => {
  await page.setViewportSize({ width: 390, height: 844 });
  await openEditor("MoveToCorner-Demo-0");
  const first = await sceneNow(), box = /** @type {any} */ (await handle("block 0").boundingBox());
  const session = await browser.context.newCDPSession(page), [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const touch = (/** @type {"touchStart" | "touchMove" | "touchEnd"} */ type, /** @type {number[][]} */ ...points) =>
    session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y]) => ({ x, y })) });
  await touch("touchStart", [x, y]);
  for (let i = 1; i <= 6; i++) await touch("touchMove", [x - 10 * i, y - 5 * i]);
  await touch("touchEnd");
  const [before, after] = [first, await sceneNow()].map(({ blocks }) => blocks[0]);
  const { width } = /** @type {any} */ (await page.locator("#editor .board").boundingBox());
  assert.ok(Math.abs(before.x - after.x - 60 * 2.04 / width) < 0.02 && Math.abs(after.y - before.y - 30 * 2.04 / width) < 0.02, JSON.stringify([before, after]));
  assert.equal(await page.evaluate(() => scrollY), 0);
  assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "nothing is wider than the phone");
  assert.deepEqual(await barriers(page), []);
  complaints.length = 0;  // those about axe's styles
});

test("a changed scene offers what works in it, and Back leaves the editor", async () => {
  await openEditor("MatchRegions-Layout-0");
  await page.keyboard.press("ArrowLeft");
  await button("Play it").click();
  await page.waitForFunction(() => location.hash.includes("?scene=") && document.getElementById("status")?.textContent?.startsWith("Press"));
  const scene = new URLSearchParams(new URL(page.url()).hash.split("?")[1]).get("scene");
  assert.deepEqual(await page.$$eval("#shifts select", (all) => all.map((one) => /** @type {HTMLSelectElement} */ (one).name)), ["latency", "slip", "friction"]);
  await page.selectOption("[name=slip]", "5");
  await page.waitForFunction(() => location.hash.includes("?shifts=slip:5&scene="));
  await ready();
  assert.equal(new URLSearchParams(new URL(page.url()).hash.split("?")[1]).get("scene"), scene, "the scene stays");
  const groups = () => page.$$eval("#watch optgroup", (all) => all.map((one) => /** @type {HTMLOptGroupElement} */ (one).label));
  assert.deepEqual(await groups(), ["Policies that act in this page"]);
  await page.keyboard.press("h");
  await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("The expert runs in Python"));
  await page.click("#edit");
  await page.waitForSelector("#editor");
  await page.goBack();
  await page.waitForFunction(() => !document.getElementById("editor") && location.hash.includes("?scene="));
  await page.goBack();
  await page.waitForFunction(() => location.hash === "#MatchRegions-Layout-0");
  await ready();
  assert.ok((await groups()).includes("Recorded episodes of the leaderboard") && await page.isVisible("#shifts"));
  assert.deepEqual(complaints, []);
});
