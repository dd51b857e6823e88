// @ts-check
/** The page for inspecting models, in headless Chromium: it opens all scenes and other models, and simulates them like Python. */
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdir, mkdtemp, readFile, symlink, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { before, test } from "node:test";
import { downloaded } from "./browser.mjs";
import { OUT, browser, complaints, page, site } from "./opened.mjs";

const PYTHON = fileURLToPath(new URL("../../.venv/bin/python", import.meta.url));
const STEPS = 100, TOLERANCE = 1e-9;

before(async () => {
  await page.setViewportSize({ width: 400, height: 500 });  // few pixels, because software renders them
});

const message = () => page.textContent("#message");
/** @param {string} name */
const untilOpen = (name) => page.waitForFunction((name) => document.title.startsWith(`${name} `)
  && document.getElementById("message")?.textContent === "", name);
/** @param {Record<string, string>} files */
const openFiles = (files) => page.setInputFiles("#file", Object.entries(files).map(
  ([name, text]) => ({ name, mimeType: "text/plain", buffer: Buffer.from(text) })));
/** The scene that the page's lists and link show. */
const choice = () => page.evaluate(() => {
  const [task, variant, seed, play] = ["task", "variant", "seed", "play"].map((id) => /** @type {any} */ (document.getElementById(id)));
  return { task: task.value, variant: variant.value, seed: seed.value, play: play.hidden ? "" : play.getAttribute("href") };
});
const NOTHING = { task: "", variant: "", seed: "", play: "" };
/** The file of a scene. @param {string} name */
async function savedModel(name) {
  await page.evaluate((hash) => { location.hash = hash; }, name);
  await untilOpen(name);
  return decodeURIComponent((await page.getAttribute("#model", "href"))?.split(",").slice(1).join(",") ?? "");
}
const state = async () => JSON.parse((await downloaded(page, "#state")).text);

test("a third of the scenes open, of each task and variant", async () => {  // play.test.mjs opens others
  await page.goto(`${site.address}play/inspect.html`);
  const since = performance.now();
  const { environments } = await page.evaluate(async () => (await fetch("catalogue.json")).json());
  const chosen = environments.filter((/** @type {unknown} */ _, /** @type {number} */ number) => number % 3 === 2);
  for (const { task, variant } of chosen) {
    const name = `${task}-${variant}-0`;
    await page.evaluate((hash) => { location.hash = hash; }, name);
    await untilOpen(name);
    assert.ok(await page.locator("#tree button", { hasText: "robot" }).count());
  }
  await page.selectOption("#variant", "Demo");
  await untilOpen("SweepToTop-Demo-0");
  await page.goBack();
  await untilOpen("SweepToTop-All-0");
  const shifted = "FindDupe-Demo-1?shifts=clutter:2";
  await page.evaluate((hash) => { location.hash = hash; }, shifted);
  await untilOpen(shifted);
  assert.equal(await page.locator("#tree button", { hasText: /^pebble\d+$/ }).count(), 2);
  assert.deepEqual(complaints, []);
  console.log(`${chosen.length} scenes opened in ${((performance.now() - since) / 1000).toFixed(0)} s`);
});

test("after 100 steps, states equal Python's, also for other models with further files", async () => {
  /** @type {any[]} */
  const cases = JSON.parse(await readFile(`${OUT}site-test/stepped.json`, "utf8"));
  await page.goto("about:blank");
  await page.goto(`${site.address}play/inspect.html`);
  await page.waitForFunction(() => document.title.startsWith("Move"));
  for (const { name, files, qpos, qvel } of cases) {
    await openFiles(files);
    await untilOpen(name.endsWith(".xml") ? name : `${name}.xml`);
    await page.evaluate((steps) => {
      for (const slider of /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("#controls input"))) {
        slider.value = slider.max;
        slider.dispatchEvent(new Event("input"));
      }
      const clock = () => Number(document.getElementById("time")?.textContent?.split(" ")[0]);
      const step = /** @type {HTMLElement} */ (document.getElementById("step"));
      const isOurs = !document.getElementById("legend")?.hidden;
      for (let i = 0; i < (isOurs ? steps / 10 : steps); i++) step.click();
      return clock();
    }, STEPS);
    const there = await state();
    const difference = Math.max(...[...qpos, ...qvel].map((value, i) => Math.abs(value - [...there.qpos, ...there.qvel][i])));
    console.log(`${name}: ${difference.toExponential(1)}`);
    assert.ok(difference < TOLERANCE, `${name}: ${difference}`);
  }
  assert.deepEqual(complaints, []);
});

test("a clicked body is described, with the file's comment", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/inspect.html#MoveToCorner-Demo-0`);
  await untilOpen("MoveToCorner-Demo-0");
  await page.locator("#tree button", { hasText: /^block0$/ }).click();
  const words = await page.textContent("#about");
  for (const part of ["Block 0: ", "Mass0.5", "block0_x", "slide", "feet of blocks"]) assert.ok(words?.includes(part), part);
  await page.evaluate(() => { location.hash = "#MoveToRegion-Demo-0"; });
  await untilOpen("MoveToRegion-Demo-0");
  await page.locator("#solids").scrollIntoViewIfNeeded();
  const box = /** @type {any} */ (await page.locator("#solids").boundingBox());
  const found = new Set();
  for (let x = 0.1; x < 0.8 && !found.has("face"); x += 0.08) for (let y = 0.2; y < 0.9; y += 0.06) {
    await page.mouse.click(box.x + x * box.width, box.y + y * box.height);
    found.add(await page.textContent("#about h2"));
  }
  assert.ok(found.has("world") && found.has("face"), [...found].join());
});

test("keys drive the robot, and helper geoms and plots follow", async () => {
  await page.evaluate(() => { location.hash = "#FindDupe-All-3"; });
  await untilOpen("FindDupe-All-3");
  const begun = await state();
  for (const name of ["contacts", "joints", "inertia", "collision"]) await page.check(`[name=${name}]`);
  await page.click("#sensors summary");
  await page.focus("#solids");
  await page.keyboard.down("ArrowUp");
  await page.evaluate(() => {
    Object.assign(window, { frames: 0 });
    const count = () => { /** @type {any} */ (window).frames++; requestAnimationFrame(count); };
    count();
  });
  const since = performance.now();
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 1.5);
  const rate = Number(await page.evaluate("frames")) / (performance.now() - since) * 1000;
  await page.keyboard.press("p");  // while it drives: on a busy machine it would stop before the pause
  const driven = await state();
  await page.keyboard.up("ArrowUp");
  await page.locator("#tree button", { hasText: /^robot$/ }).click();
  const [position, joints] = await page.evaluate(() => [...document.querySelectorAll("#about table")].map(
    (table) => [.../** @type {HTMLTableElement} */ (table).rows].map((row) => row.cells)).map((rows, i) => i
    ? rows.filter(([name]) => /^robot_[xy]$/.test(name.textContent ?? "")).map((cells) => Number(cells[2].textContent))
    : (rows[0][1].textContent ?? "").split(" ").slice(0, 2).map(Number)));
  assert.ok(Math.hypot(...driven.qvel.slice(-12, -10)) > 0.1, "it moves");
  assert.deepEqual(position, joints, "the position is that of the current state");
  console.log(`${rate.toFixed(0)} frames/s with all helpers, by software`);
  assert.ok(driven.time > begun.time);
  assert.notDeepEqual(driven.qpos, begun.qpos);
  assert.match(await page.textContent("#plot") ?? "", /robot_x/);
  assert.equal((await downloaded(page, "#picture")).name, "FindDupe-All-3.png");
  await page.keyboard.press("r");
  assert.deepEqual((await state()).qpos, begun.qpos);
  await page.click("#expert");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0.4);
  assert.deepEqual(complaints, []);
});

test("with actions that are speeds, keys and the expert work as well", async () => {
  await page.evaluate(() => { location.hash = "#SweepToTop-Demo-0"; });
  await untilOpen("SweepToTop-Demo-0");
  const begun = await state();
  await page.focus("#solids");
  await page.keyboard.press("ArrowUp");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0.2);
  await page.keyboard.press("p");
  assert.notDeepEqual((await state()).qpos, begun.qpos);
  await page.click("#expert");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0.4);
  assert.deepEqual(complaints, []);
});

test("the lists show the displayed scene, and are empty for other models", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/inspect.html#MoveToCorner-Demo-0`);
  const file = await savedModel("FindDupe-All-3"), shifted = await savedModel("FindDupe-Demo-1?shifts=clutter:2");
  /** @type {any[]} */
  const cases = JSON.parse(await readFile(`${OUT}site-test/stepped.json`, "utf8"));
  const { files: cartpole } = cases.find(({ name }) => name === "cartpole.xml");
  for (const [files, right] of /** @type {[Record<string, string>, object][]} */ ([
    [{ "FindDupe-All-3.xml": file }, { task: "FindDupe", variant: "All", seed: "3", play: "./#FindDupe-All-3" }],
    [{ "shifted.xml": shifted }, { task: "FindDupe", variant: "Demo", seed: "1", play: "./#FindDupe-Demo-1?shifts=clutter:2" }],
    [{ "unknown-seed.xml": file.replace('name="seed" data="3"', 'name="seed" data="77"') }, NOTHING],
    [{ "stick.xml": file.replace('"robot":{', '"robot":{"body":"longstick",') }, NOTHING],
    [{ "own-task.xml": file.replace('data="FindDupe"', 'data="tasks:MINE"') }, NOTHING],
    [cartpole, NOTHING],
  ])) {
    await savedModel("MoveToCorner-Demo-0");
    assert.deepEqual(await choice(), { task: "MoveToCorner", variant: "Demo", seed: "0", play: "./#MoveToCorner-Demo-0" });
    await openFiles(files);
    await untilOpen(Object.keys(files).find((name) => /(FindDupe|shifted|seed|stick|task|cartpole).*xml$/.test(name)) ?? "");
    assert.deepEqual(await choice(), right);
    assert.equal(await page.evaluate("location.hash"), "#file");
  }
  assert.ok(await page.isDisabled("#seed") && await page.isDisabled("#variant"));
  await page.selectOption("#task", "FindDupe");
  await untilOpen("FindDupe-Demo-0");
  await page.goBack();
  await untilOpen("cartpole.xml");
  await page.reload();
  await page.waitForFunction(() => document.getElementById("message")?.textContent?.startsWith("The page keeps no files")
    || document.title.startsWith("cartpole.xml "));  // Firefox keeps the chosen files
  assert.deepEqual(await choice(), NOTHING);
  await page.selectOption("#task", "FindDupe");
  await untilOpen("FindDupe-Demo-0");
  const before = await choice();
  await page.evaluate(() => { location.hash = "#FindDupe-All-999"; });
  await page.waitForFunction(() => document.getElementById("message")?.textContent?.includes("cannot be shown"));
  assert.deepEqual(await choice(), before, "what is displayed stays, and so does what is said of it");
  assert.equal(await page.evaluate("location.hash"), "#FindDupe-Demo-0");
  assert.deepEqual(complaints, []);
});

test("without WebGL, scenes are drawn flat; touch buttons drive", async () => {
  const plain = await browser.context.newPage();
  await plain.addInitScript(() => {
    const get = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = /** @type {any} */ (function (/** @type {string} */ kind, /** @type {any[]} */ ...rest) {
      return /webgl/.test(kind) ? null : get.call(/** @type {any} */ (this), kind, ...rest);
    });
  });
  await plain.goto(`${site.address}play/inspect.html#MoveToCorner-Demo-0`);
  const opened = () => plain.waitForFunction(() => document.title.startsWith("MoveToCorner") && document.getElementById("message")?.textContent === "");
  await opened();
  const picture = () => plain.$eval("#solids", (canvas) => /** @type {HTMLCanvasElement} */ (canvas).toDataURL());
  const before = await picture();
  await plain.dispatchEvent("[data-command=forward]", "click");
  await plain.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0.4);
  assert.notEqual(await picture(), before);
  await plain.setInputFiles("#file", { name: "other.xml", mimeType: "text/xml", buffer: Buffer.from("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>") });
  await plain.waitForFunction(() => document.getElementById("message")?.textContent?.includes("can draw only scenes of the benchmark"));
  await plain.close();
});

/** The canvas's picture, in the page. */
async function picture() {
  await page.evaluate(() => new Promise((resolve) => { setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(resolve)), 600); }));
  const png = (await page.locator("#solids").screenshot()).toString("base64");
  return page.evaluateHandle(async (png) => {
    const image = new Image();
    image.src = `data:image/png;base64,${png}`;
    await image.decode();
    const { width, height } = image, context = /** @type {any} */ (Object.assign(document.createElement("canvas"), { width, height }).getContext("2d"));
    context.drawImage(image, 0, 0);
    return /** @type {ImageData} */ (context.getImageData(0, 0, width, height));
  }, png);
}
/** @typedef {Awaited<ReturnType<typeof picture>>} Picture */

/** The share of pixels that differ in the second picture, and the number of their colours. @param {Picture} one @param {Picture} other */
const changed = (one, other) => page.evaluate(([{ data: before }, { data: after }]) => {
  const found = [];
  for (let i = 0; i < before.length; i += 4) {
    if ([0, 1, 2].some((k) => Math.abs(before[i + k] - after[i + k]) > 12)) found.push([0, 1, 2].map((k) => after[i + k] >> 4).join());
  }
  return { share: 4 * found.length / before.length, colours: new Set(found).size };
}, /** @type {const} */ ([one, other]));

/** Whether a place is white. @param {Picture} picture @param {number[]} place  shares of width and height */
const isWhite = (picture, [x, y]) => page.evaluate(([{ data, width, height }, x, y]) => {
  const first = 4 * (Math.round(y * height) * width + Math.round(x * width));
  return data.slice(first, first + 3).every((value) => value > 253);
}, /** @type {const} */ ([picture, x, y]));

test("inertia is translucent, and collision shapes are outlines", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/inspect.html#FindDupe-All-3`);
  await untilOpen("FindDupe-All-3");
  await page.uncheck("[name=insets]");
  const plain = await picture();
  await page.check("[name=inertia]");
  const inertia = await changed(plain, await picture());
  await page.uncheck("[name=inertia]");
  await page.check("[name=collision]");
  const collision = await changed(plain, await picture());
  console.log(`changed pixels: ${(100 * inertia.share).toFixed(1)} % with inertia, in ${inertia.colours} colours; ${(100 * collision.share).toFixed(1)} % with collision shapes`);
  assert.ok(inertia.share > 0.02 && inertia.colours > 30, "what is behind a box is visible");
  assert.ok(collision.share > 0.005 && collision.share < 0.12, "lines, not faces");
  assert.deepEqual(complaints, []);
});

test("the pictures of the model's cameras can be dragged, and the view stays", async () => {
  await page.check("[name=insets]");
  await page.uncheck("[name=collision]");
  const plain = await picture(), box = /** @type {any} */ (await page.locator("#solids").boundingBox());
  const corner = [0.93, 0.06], other = [0.07, 0.94];  // of the inset and of the canvas: only the inset is white there
  await page.mouse.move(box.x + corner[0] * box.width, box.y + corner[1] * box.height);
  await page.mouse.down();
  await page.mouse.move(box.x + other[0] * box.width, box.y + other[1] * box.height, { steps: 4 });
  await page.mouse.up();
  const after = await picture();
  assert.deepEqual(await Promise.all([isWhite(plain, corner), isWhite(after, corner), isWhite(plain, other), isWhite(after, other)]), [true, false, false, true]);
  await page.uncheck("[name=insets]");
  const moved = await picture();
  await page.evaluate(() => { location.hash = "#FindDupe-All-4"; });
  await untilOpen("FindDupe-All-4");
  await page.evaluate(() => { location.hash = "#FindDupe-All-3"; });
  await untilOpen("FindDupe-All-3");
  assert.ok((await changed(moved, await picture())).share < 0.001, "as if opened anew");
  await page.check("[name=insets]");
  assert.deepEqual(complaints, []);
});

test("on a phone, the robot is driven by touch", { skip: process.env.BROWSER === "firefox" }, async () => {
  await page.evaluate(() => { location.hash = "#MoveToRegion-Demo-0"; });
  await untilOpen("MoveToRegion-Demo-0");
  const begun = await state(), session = await browser.context.newCDPSession(page);
  const pad = page.locator("[data-command=forward]");
  await pad.scrollIntoViewIfNeeded();
  const { x, y, width, height } = /** @type {any} */ (await pad.boundingBox());
  await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [{ x: x + width / 2, y: y + height / 2 }] });
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("time")?.textContent ?? "") > 0.6);
  await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  await page.click("#run");
  assert.ok(Math.hypot(...(await state()).qpos.slice(0, 2).map((/** @type {number} */ value, /** @type {number} */ i) => value - begun.qpos[i])) > 0.2);
  assert.deepEqual(complaints, []);
});

test("errors of a model are shown, and the previous model stays", async () => {
  await openFiles({ "bad.xml": "<mujoco>\n<worldbody>\n<geom type='blob'/>\n</worldbody></mujoco>" });
  await page.waitForFunction(() => document.getElementById("message")?.textContent);
  assert.equal(await message(), "bad.xml cannot be shown.\ninvalid keyword: 'blob'\nElement 'geom', line 3\n\n3: <geom type='blob'/>");
  await openFiles({ "needy.xml": "<mujoco><asset><mesh name='x' file='a.stl'/></asset></mujoco>" });
  await page.waitForFunction(() => document.getElementById("message")?.textContent?.startsWith("needy"));
  assert.match(await message() ?? "", /needs the file a.stl: open it together/);
  assert.ok(await page.locator("#tree button", { hasText: "robot" }).count());
  await page.evaluate(() => { location.hash = "#FindDuple-All-1"; });
  await page.waitForFunction(() => location.hash === "#FindDupe-All-1");
  await page.waitForFunction(() => document.getElementById("message")?.textContent?.includes("no task “FindDuple”: this is FindDupe-All-1"));
  assert.deepEqual(complaints, []);
});

test("the command serves any scene, or a file with the files that it needs", async () => {
  const folder = await mkdtemp(join(tmpdir(), "magical-inspect-"));
  await mkdir(join(folder, "magical_mj"));
  await symlink(`${OUT}npm`, join(folder, "magical_mj", "npm"));  // the fetched packages
  const { files } = JSON.parse(await readFile(`${OUT}site-test/stepped.json`, "utf8")).at(-1);
  await mkdir(join(folder, "shapes"));
  for (const [name, text] of Object.entries(files)) await writeFile(join(folder, name.endsWith(".obj") ? "shapes" : "", name), text);
  const scene = { task: "FindDupe", variant: "All", seed: "1234", play: "./#FindDupe-All-1234" };
  for (const [what, title, right] of /** @type {[string[], string, object][]} */ ([
    [["FindDupe", "All", "--seed", "1234"], "FindDupe-All-1234", scene], [[join(folder, "tetrahedron.xml")], "tetrahedron.xml", NOTHING],
  ])) {
    const server = spawn(PYTHON, ["-m", "magical_mj", "inspect", ...what, "--port", "0"], { env: { ...process.env, XDG_CACHE_HOME: folder } });
    try {
      const { value: address } = await createInterface(server.stdout)[Symbol.asyncIterator]().next();
      await page.goto(address);
      await untilOpen(title);
      assert.deepEqual(await choice(), right);
    } finally {
      server.kill();
    }
  }
  assert.deepEqual(complaints, []);
});
