// @ts-check
/** The documentation pages: accessibility, sorting, filters, animations and charts. */
import assert from "node:assert/strict";
import { readdir } from "node:fs/promises";
import { test } from "node:test";
import { barriers, launch, PAGES, serve } from "./browser.mjs";
import { OUT, page, site } from "./opened.mjs";

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

test("no page is wider than a laptop or a phone; on a laptop, cells are not a column of single words; code scrolls in its box", async () => {
  const names = (await readdir(`${OUT}site`)).filter((name) => name.endsWith(".html") && name !== "genindex.html");
  for (const name of names) {
    await page.setViewportSize({ width: 390, height: 800 });
    await page.goto(site.address + name, { waitUntil: "domcontentloaded" });
    for (const width of [390, 1280]) {
      await page.setViewportSize({ width, height: 800 });
      const { wide, narrow } = await page.evaluate(() => {
        const cells = [...document.querySelectorAll("article :is(td, th)")].filter((cell) => /** @type {HTMLElement} */ (cell).offsetParent && !cell.closest(".standings"));
        return {
          wide: document.documentElement.scrollWidth - innerWidth,
          narrow: cells.filter((cell) => {
            const range = document.createRange(), words = (cell.textContent ?? "").trim().split(/\s+/);
            range.selectNodeContents(cell);
            const lines = new Set([...range.getClientRects()].map(({ bottom }) => Math.round(bottom / 8))).size;
            return words.length >= 5 && Math.max(...words.map(({ length }) => length)) < 16 && lines > 0.75 * words.length;
          }).map((cell) => cell.textContent),
        };
      });
      assert.ok(wide <= 0, `${name} is ${wide} px wider than ${width}`);
      if (width > 1000) assert.deepEqual(narrow, [], name);
    }
  }
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.goto(`${site.address}evaluation.html`);
  const boxes = await page.$$eval("article pre", (all) => all.filter((one) => one.scrollWidth > one.clientWidth).map((one) => getComputedStyle(one).overflowX));
  assert.ok(boxes.length > 0 && boxes.every((one) => one === "auto"), boxes.join());
});

test("the home page loads little, and its cards move when they are pointed at", async () => {
  const loaded = /** @type {string[]} */ ([]), note = (/** @type {import("playwright-core").Request} */ request) => loaded.push(request.url());
  page.on("request", note);
  await page.goto(`${site.address}index.html`, { waitUntil: "networkidle" });
  assert.deepEqual(loaded.filter((url) => /media\/(?!home|.*-still).*webp$/.test(url)), []);
  await page.locator(".card").first().hover();
  await page.waitForFunction(() => document.querySelector("img[src$='MoveToCorner.webp']"));
  page.off("request", note);
});

test("the first screen says what this is, and links work from a missing page at any depth", async () => {
  for (const [width, height] of [[1280, 800], [390, 844]]) {
    await page.setViewportSize({ width, height });
    await page.goto(`${site.address}index.html`);
    const seen = await page.evaluate(() => [...document.querySelectorAll("h1, .question, .links a, .install pre")].filter(
      (one) => one.getBoundingClientRect().bottom <= innerHeight).map((one) => /** @type {HTMLElement} */ (one).innerText).join(" "));
    for (const word of ["MAGICAL on MuJoCo: a benchmark for robust imitation learning", "Gymnasium", "What does it want?", "Watch policies fail", "Evaluate yours", "pip install"]) assert.ok(seen.includes(word), word);
  }
  await page.setViewportSize({ width: 1280, height: 800 });
  for (const missing of ["missing.html", "play/missing/deeper/still"]) {
    const reply = await page.goto(site.address + missing);
    assert.equal(reply?.status(), 404);
    await page.waitForSelector("base", { state: "attached" });
    await page.getByText("Play").click();
    await page.waitForFunction(() => document.getElementById("status"));
    assert.equal(await page.evaluate("location.pathname"), "/sub/path/play/");
  }
});

test("the search finds pages by what they are about, before objects of the API", async () => {
  for (const [query, title] of [["how to add a task", "Adding a task"], ["demonstrations", "The demonstrations"], ["clutter", "Shifts"], ["evaluate my agent", "Evaluating an agent"]]) {
    await page.goto(`${site.address}search.html?q=${encodeURIComponent(query)}`);
    await page.waitForFunction((title) => [...document.querySelectorAll("#search-results li > a")].slice(0, 2).some((one) => one.textContent === title), title);
  }
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

test("wrong goals of each task: what the page says of an episode is what it says when the episode is watched", async () => {
  await page.goto(`${site.address}explain.html`);
  const cards = await page.locator("article .card").evaluateAll((all) => all.map((card) => ({ text: card.textContent ?? "", address: card.querySelector("a")?.hash ?? "" })));
  const tasks = ["MoveToRegion", "MatchRegions", "FindDupe"], isOf = (/** @type {string} */ task) => (/** @type {{address: string}} */ card) => card.address.startsWith(`#${task}-`);
  assert.ok(cards.length >= 12);
  for (const task of tasks) {
    const card = cards.find(isOf(task));
    await page.goto("about:blank");
    await page.goto(`${site.address}play/?speed=40${card?.address}`);
    await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Over"));
    const sentence = await page.textContent("#pursued-words") ?? "";
    assert.ok(sentence.length > 20 && card?.text.includes(sentence), `${card?.address}: ${sentence}`);
  }
});

test("charts show their figures, and the leaderboard sorts, opens rows, and links to replays", async () => {
  await page.goto(`${site.address}index.html`);
  const layout = page.locator(".column", { hasText: "Layout" });
  await layout.focus();
  assert.match(await layout.locator(".figures").innerText(), /Goals and planning 0\.\d\d[^]*BC from states 0\.\d\d/);
  await page.locator(".chart label", { hasText: "BC from states" }).click();
  await page.mouse.move(0, 0);  // over the chart, it would hide the figures of the focused column
  await layout.focus();
  assert.doesNotMatch(await layout.locator(".figures").innerText(), /BC from states/);
  await page.goto(`${site.address}standings.html`);
  const table = page.locator("table.standings").first(), heading = (/** @type {string} */ name) => table.locator("thead").getByRole("button", { name });
  assert.ok(await heading("Demo (8)").isHidden());
  await page.getByLabel("all columns").check();
  await heading("Demo (8)").click();
  const place = 1 + await table.locator("thead th").evaluateAll((all) => all.findIndex((one) => /** @type {HTMLElement} */ (one).dataset.column === "Demo"));
  const whole = table.locator(`:scope > tbody:not(.partial) > tr:first-child > td:nth-child(${place})`);
  const demo = (await whole.allTextContents()).map((text) => Number.parseFloat(text) || 0);
  assert.deepEqual(demo, [...demo].sort((one, other) => other - one));
  for (const name of ["Demo (8)", "Method", "Runs"]) {  // the first one again, now rising: partial methods stay last
    await heading(name).click();
    const partial = await table.locator(":scope > tbody").evaluateAll((bodies) => bodies.map((body) => body.classList.contains("partial")));
    assert.ok(partial.includes(true));
    assert.deepEqual(partial, [...partial].sort((one, other) => Number(one) - Number(other)));
  }
  await table.locator("button.opens").first().click();
  await table.locator(".heat a").first().click();
  await page.waitForFunction(() => document.getElementById("status")?.textContent?.startsWith("Watching"));
});

test("the leaderboard filters, and two methods are compared and watched in one scene", async () => {
  await page.goto(`${site.address}standings.html`);
  const shown = () => page.locator("table.standings > tbody:not([hidden])");
  assert.match(await page.locator(".chips", { hasText: "scripted skill" }).first().innerText(), /tuned on other scenes/);
  await page.getByLabel("Sees").selectOption("states");
  await page.getByLabel("May use").selectOption("usual");
  assert.ok(await shown().filter({ hasText: "BC (ST, State)" }).first().isVisible());
  assert.equal(await shown().filter({ hasText: "scripted skill" }).count(), 0);
  assert.equal(await page.locator(".kinds output").innerText(), `${await shown().count()} methods`);
  const state = () => page.evaluate(() => [location.search, document.querySelectorAll("table.standings > tbody:not([hidden])").length, document.querySelectorAll(".details:not([hidden])").length]);
  await page.locator("button.opens:visible").first().click();
  const chosen = await state();
  assert.match(String(chosen[0]), /sees=states&uses=usual&open=/);
  await page.getByLabel("Run by").selectOption("published");
  assert.equal(await shown().count(), 0);
  await page.goBack();
  assert.deepEqual(await state(), chosen);
  await page.reload();
  assert.deepEqual(await state(), chosen);
  await page.getByText("Compare two methods").click();
  const form = page.locator("form.compare");
  await form.locator("[name=first]").selectOption({ label: "Relational (ST, State)" });
  await form.locator("[name=second]").selectOption({ label: "BC (ST, State)" });
  assert.match(await page.locator(".chance").innerText(), /^The probability that a run of Relational .*: 0\.\d\d\??\.$/);
  assert.match(await page.locator("table.compared").innerText(), /Generalisation\s+0\.\d\d \[.*\]\s+0\.\d\d \[/);
  await form.locator("[name=environment]").selectOption("FindDupe-Layout");
  await form.locator("[name=seed]").selectOption("1");
  await form.getByRole("button", { name: "Watch both" }).click();
  for (const title of ["Relational (ST, State), FindDupe-Layout, scene 1", "BC (ST, State), FindDupe-Layout, scene 1"]) {
    await page.frameLocator(`iframe[title="${title}"]`).locator("#status", { hasText: "Watching" }).waitFor();
  }
});

test("a second visit needs no network", async () => {
  const other = await serve(`${OUT}site`), keeping = await launch({ keeps: true });
  try {
    const visit = await keeping.context.newPage();
    const until = (/** @type {string} */ text) => visit.waitForFunction((text) => document.getElementById("status")?.textContent?.startsWith(text), text);
    await visit.goto(other.address);
    await visit.evaluate(async () => {  // until it is stored
      const missing = async () => (await Promise.all([".", "media/home-Demo.webp", "media/home-Layout.webp"].map((one) => caches.match(one)))).includes(undefined);
      while (await missing()) await new Promise((resolve) => setTimeout(resolve, 50));
    });
    await visit.goto(`${other.address}play/?speed=40#FindDupe-All-3`);
    await until("Press");
    await visit.waitForFunction(() => navigator.serviceWorker.controller?.scriptURL.endsWith("play/worker.js"));
    other.close();
    await visit.reload();
    await until("Press");
    await visit.selectOption("#task", "MakeLine");
    await visit.waitForFunction(() => location.hash.startsWith("#MakeLine"));
    await until("Press");
    await visit.keyboard.press("h");
    await until("Over: score 1.00");
    await visit.goto(`${other.address}play/inspect.html#FindDupe-All-3`);
    await visit.waitForFunction(() => document.title.startsWith("FindDupe-All-3 ") && !document.getElementById("poster"));
    assert.equal(await visit.textContent("#message"), "");
    await visit.goto(`${other.address}index.html`);
    await visit.waitForFunction(() => [...document.querySelectorAll("figure img")].every((image) => /** @type {HTMLImageElement} */ (image).naturalWidth === 448));
    await visit.goto(`${other.address}play/intents.html#line(all)`);
    await visit.locator("#scenes a").first().waitFor();
  } finally {
    await keeping.close();
    other.close();
  }
});
