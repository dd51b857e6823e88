// @ts-check
/** The page for playing with a Python server: `magical-mj collect`, in headless Chromium. */
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtemp, readdir, readFile, writeFile } from "node:fs/promises";
import { once } from "node:events";
import { createInterface } from "node:readline";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { test } from "node:test";
import { barriers, launch } from "./browser.mjs";

const PYTHON = fileURLToPath(new URL("../../.venv/bin/python", import.meta.url));

/** Starts a server on any free port: for a study if the first option is its folder. @param {string[]} options */
const serve = (...options) => spawn(PYTHON, ["-m", "magical_mj", options[0]?.startsWith("--") ? "serve" : "collect", "--port", "0", ...options]);
/** The address that a server prints. @param {import("node:child_process").ChildProcessByStdio<any, any, any>} server */
const addressOf = async (server) => (await createInterface(server.stdout)[Symbol.asyncIterator]().next()).value;
/** @param {import("playwright-core").Page} page @param {string} text */
const untilStatus = (page, text) => page.waitForFunction(
  (text) => document.getElementById("status")?.textContent?.includes(text), text);
/** The options for a study of MoveToRegion with all features for participants. @param {string} folder @param {Record<string, number>} quotas */
async function study(folder, quotas) {
  const lines = Object.entries(quotas).map(([variant, wanted]) => `MoveToRegion-${variant} = ${wanted}`);
  await writeFile(`${folder}.toml`, ['shows = ["expert", "speed", "scenes"]', 'consent = "What you do is stored."', "[environments]", ...lines].join("\n"));
  return [folder, "--study", `${folder}.toml`];
}
/** Collects the confirmations that a page requests, and declines all. @param {import("playwright-core").Page} page */
function questionsOf(page) {
  /** @type {string[]} */
  const questions = [];
  page.on("dialog", (dialog) => { questions.push(dialog.message()); dialog.dismiss(); });
  return questions;
}

test("participants play at the server and send their episodes", async () => {
  const folder = await mkdtemp(join(tmpdir(), "magical-study-"));
  const options = await study(folder, { Demo: 1, Layout: 1 });
  let server = serve(...options);
  const browser = await launch();
  try {
    const address = await addressOf(server);
    const page = await browser.context.newPage();
    /** @type {string[]} */
    const complaints = [];
    page.on("console", (message) => { if (message.type() === "error") complaints.push(message.text()); });
    page.on("pageerror", (error) => complaints.push(error.message));
    const questions = questionsOf(page);
    await page.goto(`${address}?speed=10`);
    await page.click("#agree");
    for (const variant of ["Demo", "Layout"]) {
      await untilStatus(page, "ress a key");
      assert.equal(await page.inputValue("#variant"), variant);
      await page.keyboard.down("ArrowUp");
      await untilStatus(page, "Over");
      await page.keyboard.up("ArrowUp");
      await page.keyboard.press("n");  // it asks before it discards an unsent episode
      await untilStatus(page, "Over");
      if (variant === "Layout") {
        server.kill();
        await once(server, "exit");
        await page.click("#save");
        await untilStatus(page, "no connection to the server: trying again");
        server = serve(...options, "--port", new URL(address).port);
        assert.equal(await addressOf(server), address);
      } else await page.click("#save");
      await untilStatus(page, "Kept");
    }
    assert.deepEqual(questions, Array(2).fill("This episode was not sent. Leave it?"));
    assert.match(await page.textContent("#status") ?? "", /everything/);
    await page.fill("#seed", "12345");
    await page.press("#seed", "Enter");
    await page.waitForFunction(() => location.hash.endsWith("-12345"));
    const [participant, ...others] = await readdir(folder);
    assert.match(participant, /^[0-9a-f]{16}$/);
    assert.deepEqual(others, ["operator", "study.jsonl", "token"]);
    assert.equal((await readdir(join(folder, participant))).length, 2);
    await page.goto(address.replace(/[^/]+\/$/, `${await readFile(join(folder, "operator"), "utf8")}/operator.html`));
    await page.waitForFunction(() => document.getElementById("people")?.textContent === "1 participant");
    assert.deepEqual(await barriers(page), []);
    assert.deepEqual(complaints.filter((text) => !text.includes("ERR_CONNECTION_REFUSED")), []);
  } finally {
    await browser.close();
    server.kill();
  }
});

test("a study counts its episodes, survives a restart within one, and keeps the completion code", async () => {
  const folder = await mkdtemp(join(tmpdir(), "magical-study-"));
  await writeFile(`${folder}.toml`, ['title = "Pushing blocks"', 'completion_code = "MAGIC-42"', "episodes = 2", "practice = 1",
    "[environments]", "MoveToRegion-Demo = 9"].join("\n"));
  const options = [folder, "--study", `${folder}.toml`];
  let server = serve(...options);
  const browser = await launch();
  try {
    const address = await addressOf(server), page = await browser.context.newPage();
    await page.goto(address);
    for (const turn of ["Practice 1 of 1: this episode does not count.", "Episode 1 of 2", "Episode 2 of 2"]) {
      await page.waitForFunction((turn) => document.getElementById("turn")?.textContent === turn, turn);
      await untilStatus(page, "ress a key");
      assert.equal(await page.textContent("h1"), "Pushing blocks");
      await page.keyboard.press("ArrowUp");
      if (turn.startsWith("Episode 1")) {
        await page.keyboard.down("ArrowUp");
        await untilStatus(page, "Playing");
        await page.waitForFunction(() => /** @type {any} */ (document.getElementById("time")).value > 0.1);
        server.kill();
        await once(server, "exit");
        await untilStatus(page, "no connection to the server: trying again");
        server = serve(...options, "--port", new URL(address).port);
        await addressOf(server);
        await untilStatus(page, "Playing");
        await page.keyboard.up("ArrowUp");
      }
      await untilStatus(page, "Over");
      await page.click("#save");
      await untilStatus(page, turn.startsWith("Practice") ? "That was practice" : "Kept");
    }
    assert.ok(await page.isDisabled("#save"), "an episode is sent once");
    assert.equal(await page.evaluate("document.activeElement.id"), "arena");  // a disabled button would swallow keys
    for (const key of ["", "r", "n"]) {
      if (key) await page.keyboard.press(key);
      assert.match(await page.textContent("#ending") ?? "", /everything.*Your code: MAGIC-42/);
    }
    await page.reload();
    await page.waitForSelector("#ending:not([hidden])");
    assert.match(await page.textContent("#ending") ?? "", /MAGIC-42/);
    const [participant] = await readdir(folder);
    assert.equal((await readdir(join(folder, participant))).length, 2);
  } finally {
    await browser.close();
    server.kill();
  }
});

test("if a server stops answering, no episode is lost, and the page soon reports it", async () => {
  const folder = await mkdtemp(join(tmpdir(), "magical-study-"));
  const server = serve(...await study(folder, { Demo: 9, Layout: 9, All: 9 }));
  const browser = await launch();
  try {
    const address = await addressOf(server);
    const page = await browser.context.newPage();
    const questions = questionsOf(page);
    await page.clock.install();
    await page.goto(`${address}?speed=40`);
    await page.click("#agree");
    await untilStatus(page, "ress a key");
    await page.keyboard.press("ArrowUp");
    await untilStatus(page, "Over");
    server.kill("SIGSTOP");
    await page.click("#save");
    await untilStatus(page, "Sending");
    await page.keyboard.press("n");
    assert.deepEqual(questions, ["This episode was not sent. Leave it?"]);
    await page.clock.fastForward(60000);
    await untilStatus(page, "no connection to the server: trying again");
    server.kill("SIGCONT");
    await untilStatus(page, "Kept");
    await page.evaluate("confirm = () => true");  // another scene is chosen before the answer arrives, and loaded after it
    /** @type {() => unknown} */
    let release = assert.fail;
    await page.route("**/MoveToRegion-All.json", (route) => { release = () => route.continue(); });
    await page.keyboard.press("ArrowUp");
    await untilStatus(page, "Over");
    server.kill("SIGSTOP");
    await page.click("#save");
    await untilStatus(page, "Sending");
    await page.selectOption("#variant", "All");
    server.kill("SIGCONT");
    await untilStatus(page, "Kept");
    release();
    await page.waitForFunction(() => location.hash.startsWith("#MoveToRegion-All-"));
    await page.waitForFunction(() => document.getElementById("left")?.textContent);
    await untilStatus(page, "Kept");
    await page.keyboard.press("ArrowUp");
    await untilStatus(page, "Over");
  } finally {
    await browser.close();
    server.kill("SIGKILL");
  }
});

test("a seed can be chosen by keyboard without playing, and the host may have any spelling", async () => {
  const server = serve("--host", "LOCALHOST");
  const browser = await launch();
  try {
    const address = await addressOf(server);
    const page = await browser.context.newPage();
    const focused = () => page.evaluate(() => document.activeElement?.id);
    await page.goto(address);
    await untilStatus(page, "ress a key");
    await page.focus("#seed");
    for (const seed of ["1", "2"]) {
      await page.keyboard.press("ArrowUp");
      await page.waitForFunction((seed) => location.hash.endsWith(`-${seed}`), seed);
      await untilStatus(page, "ress a key");
      assert.equal(await focused(), "seed");
    }
    await page.keyboard.press("Enter");
    assert.equal(await focused(), "arena");
  } finally {
    await browser.close();
    server.kill();
  }
});

test("requests for another address than the server's get advice", async () => {
  const server = serve("--host", "0.0.0.0");
  const browser = await launch();
  try {
    const address = await addressOf(server);
    const page = await browser.context.newPage();
    const response = await page.goto(address.replace("localhost", "127.0.0.1"));
    assert.equal(response?.status(), 421);
    assert.match(await page.textContent("body") ?? "", /start the server with --origin/);
  } finally {
    await browser.close();
    server.kill();
  }
});
