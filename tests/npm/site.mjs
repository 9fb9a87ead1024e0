// A site of another origin than the server, and Chromium.

import { once } from "node:events";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { extname } from "node:path";

import { ROOT, packaged } from "./support.mjs";

const MEDIA = {
  ".js": "text/javascript",
  ".mjs": "text/javascript",
  ".png": "image/png",
  ".jpg": "image/jpeg",
  ".html": "text/html; charset=utf-8",
  ".css": "text/css",
  ".wasm": "application/wasm",
};

/** Serves pages, the package below /npm/, and the pictures of the repository below /images/. */
export async function site(pages = {}, folders = {}) {
  // Browsers ask for an icon.
  pages["/favicon.ico"] ??= "";
  const roots = {
    ...folders,
    "/npm/": `${ROOT}api/npm/`,
    "/images/": `${ROOT}tests/images/`,
  };
  const headers = {};
  const server = createServer((request, response) => {
    const { pathname } = new URL(request.url, "http://localhost");
    const folder = Object.keys(roots).find((name) => pathname.startsWith(name));
    try {
      const body = pages[pathname] ?? readFileSync(roots[folder] + pathname.slice(folder.length));
      const type = MEDIA[extname(pathname)] ?? MEDIA[".html"];
      response.writeHead(200, { "Content-Type": type, ...headers }).end(body);
    } catch {
      response.writeHead(404).end();
    }
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  return {
    pages,
    /** Of every answer, such as a policy. */
    headers,
    address: `http://127.0.0.1:${server.address().port}`,
    close() {
      server.closeAllConnections();
      server.close();
    },
  };
}

/** Debian's Chromium, with WebGL by the processor. */
export function launch() {
  const { chromium } = packaged("playwright-core");
  const executablePath = process.env.MLSWARP_CHROMIUM ?? "/usr/bin/chromium-headless-shell";
  const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
  return chromium.launch({ executablePath, args });
}

/** A page whose errors and warnings are kept, and the events of its elements. */
export async function visit(browser, address, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1000, height: 760 }, ...options });
  const page = await context.newPage();
  page.errors = [];
  page.on("pageerror", (error) => page.errors.push(String(error)));
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type())) page.errors.push(message.text());
  });
  await page.addInitScript(() => {
    window.heard = [];
    for (const type of ["warpready", "warpinput", "warpchange", "warperror"])
      addEventListener(type, ({ detail }) => {
        const told = detail instanceof Error ? { name: detail.name, code: detail.code } : detail;
        window.heard.push({ type, detail: JSON.parse(JSON.stringify(told)) });
      });
  });
  await page.goto(address);
  return page;
}

/** Waits until the element of a page shows the server's picture. */
export const ready = (page) =>
  page.waitForFunction(() => document.querySelector("mls-warp")?.state === "ready", null, {
    timeout: 20_000,
  });

/** The middle of a handle, CSS px of the window. */
export async function middle(page, index) {
  const { x, y, width, height } = await page.locator(`#handle-${index}`).boundingBox();
  return [x + width / 2, y + height / 2];
}
