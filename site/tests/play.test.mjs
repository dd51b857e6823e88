// @ts-check
/** The page for playing in headless Chromium, below a sub-path: each environment is opened and driven by keys. */
import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import { before, test } from "node:test";
import { downloaded } from "./browser.mjs";
import { OUT, browser, complaints, page, site } from "./opened.mjs";

const SPEED = 40;

before(async () => {
  page.on("request", (request) => { if (!/^(blob|data):/.test(request.url()) && !request.url().startsWith(site.address)) complaints.push(`elsewhere: ${request.url()}`); });
  await page.addInitScript(() => {  // counts frames, and stores the time of the first one
    const watch = Object.assign(window, { frames: 0, firstDrawn: 0 }), ask = window.requestAnimationFrame;
    window.requestAnimationFrame = (callback) => ask((time) => { watch.frames += 1; callback(time); });
    const fill = CanvasRenderingContext2D.prototype.fill;
    CanvasRenderingContext2D.prototype.fill = function (...rest) {
      watch.firstDrawn ||= performance.now();
      return fill.apply(this, /** @type {any} */ (rest));
    };
  });
});

const frames = () => page.evaluate("frames");
const status = () => page.textContent("#status");
/** @param {string} text */
const untilStatus = (text) => page.waitForFunction((text) => document.getElementById("status")?.textContent?.startsWith(text), text);
const picture = () => page.$eval("#allo", (canvas) => /** @type {HTMLCanvasElement} */ (canvas).toDataURL());
/** @param {number} count */
const moreFrames = async (count) => {
  const start = await frames();
  await page.waitForFunction((wanted) => /** @type {any} */ (window).frames >= wanted, Number(start) + count);
};

test("it opens and is played", async () => {
  await page.goto(`${site.address}play/#FindDupe-All-3`);
  await untilStatus("Press");
  const ready = await page.evaluate("performance.now()"), first = await page.evaluate("firstDrawn");
  await page.keyboard.down("ArrowUp");
  const start = Number(await frames()), since = performance.now();
  await page.waitForTimeout(2000);
  const rate = (Number(await frames()) - start) / (performance.now() - since) * 1000;
  await page.keyboard.up("ArrowUp");
  console.log(`first frame after ${Number(first).toFixed(0)} ms, ready to play after ${Number(ready).toFixed(0)} ms, ${rate.toFixed(0)} frames/s`);
  assert.equal(await status(), "Playing");
  assert.ok(rate > 0);
});

test("each task and each variant can be played, and SweepToTop", async () => {  // others are opened in inspect.test.mjs
  await page.goto(`${site.address}play/?speed=${SPEED}`);
  const { environments } = await page.evaluate(async () => (await fetch("catalogue.json")).json());
  assert.equal(environments.length, 66);
  const since = performance.now(), seen = new Set();
  const chosen = environments.filter((/** @type {any} */ { task, variant }) => {
    const fresh = variant === "All" || !seen.has(task) || !seen.has(variant);
    seen.add(task).add(variant);
    return fresh;
  });
  for (const { task, variant } of chosen) {
    await page.evaluate((hash) => { location.hash = hash; }, `${task}-${variant}-1`);
    await page.waitForFunction(([task, variant]) => /** @type {any} */ (document.getElementById("task")).value === task
      && /** @type {any} */ (document.getElementById("variant")).value === variant, [task, variant]);
    await untilStatus("Press");
    const { horizon } = await page.evaluate(async (name) => (await fetch(`scenes/${name}.json`)).json(), `${task}-${variant}`);
    const before = await picture(), share = 25 / horizon;
    for (const key of ["ArrowUp", "Space", "KeyD"]) await page.keyboard.down(key);
    await page.waitForFunction((share) => /** @type {any} */ (document.getElementById("time")).value >= share - 1e-9, share);
    for (const key of ["ArrowUp", "Space", "KeyD"]) await page.keyboard.up(key);
    await moreFrames(5);
    assert.notEqual(await picture(), before, `${task}-${variant}: nothing moved`);
    assert.deepEqual(complaints, [], `${task}-${variant}`);
  }
  console.log(`${chosen.length} environments in ${((performance.now() - since) / 1000).toFixed(0)} s`);
});

test("the expert reaches the full score, and a player's episode is saved", async () => {
  await page.goto(`${site.address}play/?speed=${SPEED}#MatchRegions-All-2`);
  await untilStatus("Press");
  await page.keyboard.press("h");
  await untilStatus("Over");
  assert.equal(await page.textContent("#score"), "1.00");
  assert.ok(await page.isDisabled("#save"), "only what was played oneself can be saved");
  await page.keyboard.press("r");
  await untilStatus("Press");
  await page.keyboard.down("KeyW");
  await untilStatus("Over");
  await page.keyboard.up("KeyW");
  const { name, text } = await downloaded(page, "#save"), saved = JSON.parse(text);
  assert.equal(name, "MatchRegions-All-2.json");
  await writeFile(`${OUT}site-test/saved.json`, text);
  assert.deepEqual([saved.task, saved.variant, saved.seed, saved.actions.length], ["MatchRegions", "All", 2, 120]);
  assert.deepEqual(complaints, []);
});

test("shifted scenes and other bodies can be chosen and linked to", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/?speed=${SPEED}#FindDupe-Demo-2?shifts=clutter:3`);
  await untilStatus("Press");
  const cluttered = await picture();
  assert.equal(await page.inputValue("[name=clutter]"), "3");
  await page.selectOption("[name=slip]", "5");
  await page.waitForFunction(() => location.hash === "#FindDupe-Demo-2?shifts=clutter:3,slip:5");
  await page.selectOption("[name=pose]", "4");  // other poses and pebbles cannot be combined here
  await page.waitForFunction(() => location.hash === "#FindDupe-Demo-2?shifts=pose:4,slip:5");
  await untilStatus("Press");
  await moreFrames(2);
  assert.notEqual(await picture(), cluttered);
  await page.selectOption("#watch", "demo-1");
  await untilStatus("Over");
  assert.ok(await page.isDisabled("#save"));
  for (const body of ["", "?shifts=body:shortstick", "?shifts=body:mediumstick", "?shifts=body:longstick"]) {
    await page.evaluate((hash) => { location.hash = hash; }, `SweepToTop-All-1${body}`);
    await untilStatus("Press");
    await page.keyboard.press("h");
    await untilStatus("Over: score 1.00");
  }
  await page.selectOption("#variant", "Layout");
  await page.waitForFunction(() => location.hash === "#SweepToTop-Layout-0?shifts=body:longstick@expert");
  await page.evaluate(() => { location.hash = "#SweepToTop-Demo-0?shifts=body:longstik"; });
  await untilStatus("There is no shift “body:longstik” of SweepToTop-Demo: this is SweepToTop-Demo-0?shifts=body:longstick");
  await page.evaluate(() => { location.hash = "#FindDupe-All-1?shifts=friction:2,clutter:4"; });
  await page.waitForFunction(() => location.hash === "#FindDupe-All-1?shifts=clutter:4,friction:2");
  await untilStatus("Press");
  assert.deepEqual(complaints, []);
});

test("combined shifts have the effect that they have in Python", async () => {
  /** @type {any[]} */
  const cases = JSON.parse(await readFile(`${OUT}site-test/combined.json`, "utf8"));
  for (const { task, variant, seed, shifts, actions, final } of cases) {
    const there = await page.evaluate(async ({ task, variant, seed, shifts, actions }) => {
      const { inBrowser, loadEnvironment } = await import(new URL("scenes.js", document.baseURI).href);
      const environment = await loadEnvironment(task, variant, shifts), entry = environment.scenes.find((/** @type {any} */ one) => one.seed === seed);
      const episode = await inBrowser(Promise.resolve())(environment, entry, task, variant);
      let scene = episode.scene;
      for (const action of actions) scene = await episode.act(action);
      episode.close();
      return scene;
    }, { task, variant, seed, shifts, actions });
    const numbers = (/** @type {any} */ { robot, blocks, dynamics }) => [robot, ...blocks].flatMap(({ x, y, angle }) => [x, y, angle]).concat(Object.values(dynamics));
    const apart = Math.max(...numbers(final).map((value, i) => Math.abs(value - numbers(there)[i])));
    assert.ok(apart < 1e-6, `${task}-${variant}-${seed} with ${shifts}: ${apart}`);
  }
});

test("nothing starts by itself, independent of earlier keys and the address", async () => {
  await page.goto(`${site.address}play/?speed=${SPEED}#MoveToRegion-Demo-0`);
  await page.focus("#arena");
  await untilStatus("Press");
  for (let repeat = 0; repeat < 3; repeat += 1) {
    await page.keyboard.down("ArrowUp");  // repeated, as by a held key, also after the episode's end
    if (!repeat) await untilStatus("Over");
  }
  await page.keyboard.up("ArrowUp");
  await page.selectOption("#task", "FixColour");
  await untilStatus("Press");
  await moreFrames(20);
  assert.equal(await status(), "Press a key or button to start");
  await page.evaluate(() => { location.hash = "#%E0%A4%A"; });
  await untilStatus("There is no task “%E0%A4%A”");
  for (const wrong of ["FindDupe-All-abc", "FindDupe-All--3", "FindDupe-All-1e30", "FindDupe-Nothing", "Nothing-All-0"]) {
    await page.evaluate((hash) => { location.hash = hash; }, wrong);
    await page.waitForFunction((wrong) => location.hash !== `#${wrong}`, wrong);
    await untilStatus("There is no");
    assert.match(await page.evaluate("location.hash"), /^#[A-Z]\w+-[A-Z]\w+-0$/);
  }
  await page.evaluate(() => { location.hash = "#FindDuple-Layot-7@state-bc"; });
  await untilStatus("There is no task “FindDuple”, and no variant “Layot” of FindDupe: this is FindDupe-Layout-7");
  assert.equal(await page.evaluate("location.hash"), "#FindDupe-Layout-7@state-bc");
  const offers = () => page.$$eval("#watch option", (all) => all.map((one) => /** @type {HTMLOptionElement} */ (one).value));
  assert.ok((await offers()).includes("state-bc") && !(await offers()).includes("demo-1"));
  await page.selectOption("#variant", "Demo");
  await page.waitForFunction(() => location.hash === "#FindDupe-Demo-0@state-bc");
  assert.ok((await offers()).includes("demo-5"));
  await untilStatus("Watching BC");
  await page.goBack();
  await page.waitForFunction(() => location.hash === "#FindDupe-Layout-7@state-bc");
  assert.deepEqual(complaints, []);
});

test("a player takes over from the expert, on keys that are visible", async () => {
  await page.goto("about:blank");
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.goto(`${site.address}play/?speed=2#MoveToCorner-Demo-0@expert`);
  await untilStatus("Watching the expert");
  const { y = 0, height = 0 } = await page.locator("#legend").boundingBox() ?? {};
  assert.ok(y + height <= 800, `the keys end at ${y + height}`);
  await page.keyboard.press("t");
  await untilStatus("Playing");
  const place = () => page.$eval("#score", (score) => score.textContent);
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("left")?.textContent ?? "") < 4);
  assert.notEqual(await place(), "1.00");  // the expert would have pushed the block into the corner
  assert.ok(await page.isDisabled("#save"));
  await page.setViewportSize({ width: 600, height: 700 });
  assert.deepEqual(complaints, []);
});

const cannotEmulate = process.env.BROWSER === "firefox" && "tests cannot set the colour scheme of this Firefox";
test("the theme that was chosen on another page is kept", { skip: cannotEmulate }, async () => {
  const themed = await browser.context.newPage(), shownTheme = () => themed.$eval("html", (html) => html.dataset.theme);
  await themed.emulateMedia({ colorScheme: "light" });
  await themed.goto(`${site.address}play/#MoveToCorner-Demo-0`);
  assert.equal(await shownTheme(), "light");
  await themed.emulateMedia({ colorScheme: "dark" });
  await themed.waitForFunction(() => document.documentElement.dataset.theme === "dark");
  await themed.evaluate(() => localStorage.setItem("theme", "light"));
  await themed.reload();
  assert.equal(await shownTheme(), "light");
  await themed.evaluate(() => localStorage.clear());
  await themed.close();
});

for (const [path, ready] of [["play/#FindDupe-All-3@state-bc", "Watching"], ["play/inspect.html#FindDupe-All-3", ""]]) {
  test(`whichever request fails, ${path} starts, or shows what failed and starts after another try`, async () => {
    const fresh = await browser.context.newPage();
    const settled = () => fresh.waitForFunction((ready) => {
      const status = document.querySelector("[role=status]"), text = status?.textContent ?? "";
      return status?.querySelector("button") ? "failed" : (ready ? text.startsWith(ready) : text === "" && document.title.startsWith("FindDupe")) && "ready";
    }, ready).then((result) => result.jsonValue());
    /** @type {Set<string>} */
    const requests = new Set();
    fresh.on("request", (request) => requests.add(request.url().replace(/#.*/, "")));
    await fresh.goto(site.address + path);
    assert.equal(await settled(), "ready");
    const page = new URL(site.address + path.replace(/#.*/, "")).href;
    const fallible = [...requests].filter((url) => url !== page && url.startsWith("http")), day = Math.floor(Date.now() / 864e5);
    let failures = 0;
    for (const url of fallible.filter((_, number) => (number + day) % 4 === 0)) {  // others each day
      await fresh.route((one) => one.href.split("?")[0] === url, (route) => route.abort());
      await fresh.goto("about:blank");
      await fresh.goto(site.address + path);
      const result = await settled();
      await fresh.unrouteAll();
      if (result === "ready") continue;
      failures += 1;
      assert.match(await fresh.textContent("[role=status]") ?? "", /could not be loaded|failed/i, url);
      if (failures > 2) continue;  // modules are alike
      await fresh.click("[role=status] button");
      await fresh.waitForFunction(() => !document.querySelector("[role=status] button"));
      assert.equal(await settled(), "ready", url);
    }
    console.log(`${fallible.length} requests; of a quarter, ${failures} are needed to start`);
    assert.ok(failures > 3);
    await fresh.close();
  });
}

test("a policy acts, and its scores are shown", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/?speed=4#MoveToRegion-Demo-0`);
  await untilStatus("Press");
  await page.keyboard.press("b");
  await untilStatus("Watching BC from states: on average it scores 1.00 in Demo, 0.11 in Layout");
  await untilStatus("Over");
  assert.equal(await page.evaluate("location.hash"), "#MoveToRegion-Demo-0@bc");
  assert.ok(await page.isDisabled("#save"));
  await page.setInputFiles("#policy", `${OUT}site/play/policies/MoveToRegion.onnx`);
  await untilStatus("Watching your policy");
  await untilStatus("Over: score 1.00");
  await page.setInputFiles("#policy", { name: "none.onnx", mimeType: "", buffer: Buffer.from("nothing") });
  await untilStatus("The policy cannot act here: it is not an ONNX file from magical-mj export-policy");
  await page.setInputFiles("#policy", `${OUT}site-test/LoRes3EA.onnx`);
  await untilStatus("Watching your policy");
  await untilStatus("Over");
  await page.evaluate(() => { location.hash = "#FindDupe-Demo-1?shifts=clutter:2@own"; });
  await untilStatus("The policy cannot act here: it acts from images, and these cannot show stains here");
  assert.deepEqual(complaints, []);
});

test("a released key counts once, even if it was repeated", async () => {
  const actions = await page.evaluate(async () => {
    const { Controls } = await import("./controls.js");
    const controls = new Controls(document.body, []), taken = [];
    const key = (type, repeat = false) => document.body.dispatchEvent(new KeyboardEvent(type, { code: "ArrowUp", repeat, bubbles: true }));
    key("keydown");
    taken.push(controls.next());
    key("keydown", true);
    taken.push(controls.next());
    key("keydown", true);
    key("keyup");
    taken.push(controls.next());
    return taken;
  });
  assert.deepEqual(actions, [1, 1, 0]);
});

test("impatient keys before the first scene do no harm", async () => {
  await page.route("**/scenes/*.json", async (route) => {
    await new Promise((resolve) => setTimeout(resolve, 500));
    await route.continue();
  });
  await page.goto("about:blank");
  await page.goto(`${site.address}play/#MoveToRegion-All-3`);
  await untilStatus("Loading");
  for (const key of ["r", "n", "h"]) await page.keyboard.press(key);
  await untilStatus("Press");
  assert.equal(await page.evaluate("location.hash"), "#MoveToRegion-All-3");
  await page.unroute("**/scenes/*.json");
  assert.deepEqual(complaints, []);
});

test("canvases show what the renderer shows", async () => {
  const [look, pictures] = await Promise.all(["look", "pictures"].map(async (name) => JSON.parse(await readFile(`${OUT}site-test/${name}.json`, "utf8"))));
  const worst = { allo: 0, ego: 0 };
  for (const { scene, view, size, pixels } of pictures) {
    const apart = await page.evaluate(async ({ look, scene, view, size, pixels }) => {
      const { draw } = await import(new URL("draw.js", document.baseURI).href);
      const canvas = Object.assign(document.createElement("canvas"), { width: size, height: size });
      draw(canvas, look, scene, view);
      const drawn = /** @type {any} */ (canvas.getContext("2d")).getImageData(0, 0, size, size).data;
      let sum = 0;
      for (let i = 0; i < size * size; i++) for (let k = 0; k < 3; k++) sum += Math.abs(drawn[4 * i + k] - parseInt(pixels.substr(2 * (3 * i + k), 2), 16));
      return sum / (3 * size * size);
    }, { look, scene, view, size, pixels });
    worst[/** @type {keyof typeof worst} */ (view)] = Math.max(worst[/** @type {keyof typeof worst} */ (view)], apart);
  }
  console.log(`${pictures.length} pictures: mean levels apart at most ${worst.allo.toFixed(2)} from above, ${worst.ego.toFixed(2)} as the robot sees it`);
  assert.ok(Math.max(...Object.values(worst)) < 1.2);  // the renderer draws stains in coarse cells
});

test("failed downloads are repeated", async () => {
  const fresh = await browser.context.newPage();
  const until = (/** @type {string} */ text) => fresh.waitForFunction(
    (text) => document.getElementById("status")?.textContent?.includes(text), text);
  for (const file of ["mujoco.js", "mujoco.wasm"]) {
    await fresh.route(`**/mujoco/${file}*`, (route) => route.abort());
    await fresh.goto("about:blank");
    await fresh.goto(`${site.address}play/#FindDupe-All-3`);
    await until("could not be loaded");
    await fresh.unrouteAll();
    await fresh.keyboard.press("r");
    await until("Press");
  }
  await fresh.route("**/FixColour-*.json", (route) => route.abort());
  for (const slow of ["**/mujoco/mujoco.wasm*", "**/FindDupe-*.json"]) {
    await fresh.route(slow, async (route) => {
      await new Promise((resolve) => setTimeout(resolve, 2000));
      await route.continue();
    });
    await fresh.goto("about:blank");
    await fresh.goto(`${site.address}play/#FindDupe-All-3`);
    await until("Loading");
    await fresh.selectOption("#task", "FixColour");
    await until("could not be loaded");  // the first scene can still be played
    await fresh.waitForFunction(() => location.hash === "#FindDupe-All-3" && document.getElementById("left")?.textContent);
    await fresh.focus("#arena");
    await fresh.keyboard.down("ArrowUp");
    await until("Playing");
    await fresh.keyboard.up("ArrowUp");
    await fresh.unroute(slow);
  }
  await fresh.close();
});

test("with data saving, a picture is shown, and a press starts the download", async () => {
  const spared = await browser.context.newPage();
  await spared.addInitScript(() => Object.defineProperty(navigator, "connection", { value: { saveData: true } }));
  /** @type {string[]} */
  const loaded = [];
  spared.on("request", (request) => loaded.push(new URL(request.url()).pathname));
  const big = () => loaded.filter((path) => /mujoco\/|\.module\.js/.test(path));
  await spared.goto(`${site.address}play/#FindDupe-Layot-7`);
  await spared.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("There is no variant “Layot”"));
  await spared.selectOption("#task", "MakeLine");
  await spared.waitForFunction(() => document.getElementById("status")?.textContent === "Tap the picture to play");
  assert.deepEqual(big(), []);
  assert.match(String(await spared.textContent("#start")), /\d\.\d MB/);
  await spared.click("#start");
  await spared.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Press"));
  assert.match(await spared.evaluate("location.hash"), /^#MakeLine-Layout/);
  loaded.length = 0;
  await spared.goto(`${site.address}play/inspect.html#FindDuple-All-2`);
  await spared.waitForSelector("#poster");
  await spared.waitForFunction(() => document.getElementById("message")?.textContent?.includes("no task “FindDuple”: this is FindDupe-All-2"));
  await spared.fill("#seed", "3");
  await spared.press("#seed", "Enter");
  await spared.waitForFunction(() => location.hash === "#FindDupe-All-3");
  assert.equal(await spared.inputValue("#task"), "FindDupe");
  assert.deepEqual(big(), []);
  await spared.click("#start");
  await spared.waitForFunction(() => document.title.startsWith("FindDupe-All-3 "));
  assert.equal(await spared.locator("#poster").count(), 0);
  await spared.close();
});

test("of many addresses in quick succession, the last one is shown", async () => {
  await page.goto("about:blank");
  await page.goto(`${site.address}play/#MoveToCorner-Demo-0`);
  for (let i = 0; i < 40; i++) await page.evaluate((hash) => { location.hash = hash; }, `${["MoveToRegion-Jitter", "MatchRegions-Jitter", "FindDupe-All"][i % 3]}-${i % 20}`);
  await page.waitForFunction(() => document.getElementById("inspect")?.getAttribute("href")?.endsWith("#MoveToRegion-Jitter-19")
    && document.getElementById("status")?.textContent?.startsWith("Press"));
  assert.equal(await page.evaluate("location.hash"), "#MoveToRegion-Jitter-19");
});
