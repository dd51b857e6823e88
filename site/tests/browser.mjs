// @ts-check
/** Shared by the browser tests: a file server with a sub-path, and headless Chromium. */
import { createServer } from "node:http";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";
import { gzipSync } from "node:zlib";
import { chromium, firefox } from "../../out/npm/node_modules/playwright-core/index.mjs";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".wasm": "application/wasm",
  ".svg": "image/svg+xml", ".png": "image/png", ".webp": "image/webp" };
export const FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync"];

/** One page of each kind. */
export const PAGES = ["index.html", "gallery.html", "FindDupe.html", "standings.html", "explain.html", "shift-curves.html", "results.html",
  "play/#FindDupe-All-8", "play/inspect.html#FindDupe-All-3", "play/intents.html#line(all)"];

/**
 * Serves a folder at http://127.0.0.1:PORT/sub/path/.
 * @param {string} folder
 * @param {{compress?: boolean}} [how]  compress: compress files and allow browsers to cache them, as web hosts do
 */
export async function serve(folder, { compress = false } = {}) {
  const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url ?? "/", "http://x").pathname));
    const inner = path.startsWith("/sub/path/") ? path.slice("/sub/path/".length) : "..";
    const file = join(folder, inner === "" || inner.endsWith("/") ? `${inner}index.html` : inner);
    try {
      const content = await readFile(file);
      const type = TYPES[/** @type {keyof TYPES} */ (extname(file))] ?? "application/octet-stream";
      const hosted = compress ? { "cache-control": "max-age=600", "content-encoding": "gzip" } : {};
      response.writeHead(200, { "content-type": type, ...hosted }).end(compress ? gzipSync(content) : content);
    } catch {
      response.writeHead(404, { "content-type": "text/html" }).end(await readFile(join(folder, "404.html")).catch(() => ""));
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(null)));
  const { port } = /** @type {import("node:net").AddressInfo} */ (server.address());
  return { address: `http://127.0.0.1:${port}/sub/path/`, close: () => {
    server.close();
    server.closeAllConnections();
  } };
}

/**
 * Chromium, or Firefox if BROWSER says so, with a new, empty profile.
 * @param {{keeps?: boolean}} [how]  keeps: allow the service worker. Tests cannot make requests for stored files fail
 */
export async function launch({ keeps = false } = {}) {
  const profile = await mkdtemp(join(tmpdir(), "magical-site-"));
  const screen = { viewport: { width: 600, height: 700 }, acceptDownloads: true };
  const context = process.env.BROWSER === "firefox"
    ? await firefox.launchPersistentContext(profile, { channel: "moz-firefox", executablePath: "/usr/bin/firefox-esr", headless: !process.env.DISPLAY, ...screen })
    : await chromium.launchPersistentContext(profile, { executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS, ...screen });
  if (!keeps) await context.addInitScript(() => { Object.defineProperty(Navigator.prototype, "serviceWorker", { value: undefined }); });
  context.setDefaultTimeout(120000);  // machines of continuous integration may be slow
  const close = async () => {
    await context.close();
    await rm(profile, { recursive: true, force: true });
  };
  return { context, close };
}

/**
 * The accessibility problems that axe finds on a page, in light and dark mode.
 * @param {import("playwright-core").Page} page
 */
export async function barriers(page) {
  await page.evaluate(await readFile(new URL("../../out/npm/node_modules/axe-core/axe.min.js", import.meta.url), "utf8"));
  const found = (/** @type {string} */ rules) => page.evaluate(`axe.run(${rules}).then(({ violations }) => violations.map(
    ({ help, nodes }) => [help, ...nodes.slice(0, 3).map(({ html }) => html.slice(0, 300))].join("\\n")))`);
  await page.emulateMedia({ colorScheme: "light" });
  const light = await found("{}");
  await page.emulateMedia({ colorScheme: "dark" });
  return [...light, ...await found("{ runOnly: 'color-contrast' }")];
}

/**
 * Presses a button that starts a download. Returns its name and text. Firefox reports no downloads to tests, so the page is instrumented.
 * @param {import("playwright-core").Page} page @param {string} button
 * @returns {Promise<{name: string, text: string}>}
 */
export async function downloaded(page, button) {
  if (process.env.BROWSER !== "firefox") {
    const [download] = await Promise.all([page.waitForEvent("download"), page.click(button)]);
    return { name: download.suggestedFilename(), text: await readFile(await download.path(), "utf8") };
  }
  return page.evaluate((button) => new Promise((resolve) => {
    const { createObjectURL } = URL, { click } = HTMLAnchorElement.prototype;
    URL.createObjectURL = (content) => {
      HTMLAnchorElement.prototype.click = function () {
        Object.assign(HTMLAnchorElement.prototype, { click });
        /** @type {Blob} */ (content).text().then((text) => resolve({ name: this.download, text }));
      };
      URL.createObjectURL = createObjectURL;
      return createObjectURL(content);
    };
    /** @type {HTMLElement} */ (document.querySelector(button)).click();
  }), button);
}
