// @ts-check
/** What the browser tests share: a server of files under a sub-path, and headless Chromium. */
import { createServer } from "node:http";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";
import { chromium } from "../../out/npm/node_modules/playwright-core/index.mjs";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json", ".wasm": "application/wasm",
  ".svg": "image/svg+xml", ".png": "image/png", ".webp": "image/webp" };
const FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync"];

/**
 * Serves a folder at http://127.0.0.1:PORT/sub/path/.
 * @param {string} folder
 */
export async function serve(folder) {
  const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url ?? "/", "http://x").pathname));
    const inner = path.startsWith("/sub/path/") ? path.slice("/sub/path/".length) : "..";
    const file = join(folder, inner === "" || inner.endsWith("/") ? `${inner}index.html` : inner);
    try {
      const content = await readFile(file);
      response.writeHead(200, { "content-type": TYPES[/** @type {keyof TYPES} */ (extname(file))] ?? "application/octet-stream" }).end(content);
    } catch {
      response.writeHead(404).end();
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(null)));
  const { port } = /** @type {import("node:net").AddressInfo} */ (server.address());
  return { address: `http://127.0.0.1:${port}/sub/path/`, close: () => server.close() };
}

/** Chromium with a new, empty profile. */
export async function launch() {
  const profile = await mkdtemp(join(tmpdir(), "magical-site-"));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS, viewport: { width: 600, height: 700 }, acceptDownloads: true,
  });
  context.setDefaultTimeout(120000);  // machines of continuous integration may be slow
  const close = async () => {
    await context.close();
    await rm(profile, { recursive: true, force: true });
  };
  return { context, close };
}
