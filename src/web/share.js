// Export: the picture, the handles, a curl command that reproduces the picture, and a link.

import { hasKey } from "./access.js";
import * as api from "./api.js";
import { known } from "./dom.js";
import { warpOf, wire } from "./edits.js";
import { maskFile, maskPart, regionOf } from "./region.js";

/** @type {(name: string) => string} */
export const stem = (name) => name.replace(/\.[^.]*$/, "") || "picture";
/** @type {(name: string, format?: string) => string} */
export const pictureName = (name, format = "png") =>
  `${stem(name)}-warped.${format === "jpeg" ? "jpg" : format}`;
/** @type {(name: string, file: Page.Animation["file"]) => string} */
export const animationName = (name, file) =>
  file === "zip" ? `${stem(name)}-frames.zip` : pictureName(name, file);
/** @type {(name: string) => string} */
export const projectName = (name) => `${stem(name)}-project.json`;
/** @type {(name: string) => string} */
export const annotationsName = (name) => `${stem(name)}-warped.geojson`;
/** @type {(name: string) => string} */
export const handlesName = (name) => `${stem(name)}-handles.json`;

/** @type {(name: string) => string} */
const regionName = (name) => `${stem(name)}-region.png`;

/** @type {(name: string) => string} */
export const landmarksName = (name) => `${stem(name)}-landmarks.csv`;

/**
 * The points as CSV, which `POST /landmarks` reads. Lines have no row.
 * @param {Page.Document} document
 */
export function landmarksText({ handles }) {
  const points = handles.filter((handle) => handle.p.length === 1);
  const rows = points.map(({ p: [rest], q: [posed] }) => [...rest, ...posed].join(","));
  return ["px,py,qx,qy", ...rows, ""].join("\n");
}

/**
 * @param {Blob} blob
 * @param {string} name
 */
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/**
 * The picture of the current document: the shown PNG, otherwise requested from the server.
 * `output`: fields that differ from its defaults.
 * @param {Page.Sync} sync
 * @param {Page.Store} store
 * @param {Page.Output} [output]
 * @param {AbortSignal} [signal]
 * @returns {Promise<Blob>}
 */
export async function warpedPicture(sync, store, output = {}, signal = undefined) {
  await sync.settled();
  signal?.throwIfAborted();
  const { revision, document } = store.state;
  const usual = !Object.keys(output).length;
  if (usual && sync.png?.revision === revision) return sync.png.blob;
  return (
    await sync.ask((id) =>
      api.picture(id, { q: wire(document, "q"), ...(!usual && { output }) }, signal),
    )
  ).blob;
}

/**
 * The document as JSON: the warp object with one handle per line, and the mask of the region, if
 * there is one, as `region` (a PNG in base64).
 * @param {Page.State} state
 */
export async function handlesText({ picture: open, document }) {
  const region = regionOf(document);
  const picture = known(open);
  const mask = region.parts.length
    ? { region: (await maskPart(await maskFile(region, [picture.width, picture.height]))).png }
    : {};
  const { p, q, ...others } = { ...warpOf(document), ...mask };
  /** @type {(handles: Page.WireHandle[]) => string} */
  const list = (handles) =>
    handles.length ? `[\n${handles.map((h) => `    ${JSON.stringify(h)}`).join(",\n")}\n  ]` : "[]";
  const parts = [
    ["p", list(p)],
    ["q", list(q)],
    ...Object.entries(others).map(([name, value]) => [name, JSON.stringify(value)]),
  ];
  return `{\n${parts.map(([name, text]) => `  "${name}": ${text}`).join(",\n")}\n}\n`;
}

/**
 * Saves the mask of the region, which the curl command reads from a file; returns its name, or null
 * if the command needs none.
 * @param {Page.State} state
 */
export async function saveRegion({ picture, document }) {
  const region = regionOf(document);
  if (!region.parts.length || !picture || picture.linked) return null;
  const name = regionName(picture.name);
  save(await maskFile(region, [picture.width, picture.height]), name);
  return name;
}

/**
 * Quotes a word for a POSIX shell.
 * @type {(words: string) => string}
 */
const quoted = (words) =>
  /^[\w@%+=:,./-]+$/.test(words) ? words : `'${words.replaceAll("'", "'\\''")}'`;

/**
 * A file name in a form field of curl: quoted if it has special characters; `-` alone would be
 * standard input.
 * @type {(name: string) => string}
 */
const formFile = (name) =>
  name === "-"
    ? "./-"
    : /[",;\\]|^\s|\s$/.test(name)
      ? `"${name.replace(/[\\"]/g, "\\$&")}"`
      : name;

/** @type {(path: string) => string} */
const addressOf = (path) => new URL(path, document.baseURI).href;
const keyHeader = () => (hasKey() ? ' -H "Authorization: Bearer $MLSWARP_KEY"' : "");

/** Characters of JSON that are passed as an argument. Linux limits an argument to 128 KiB. */
const MOST_ARGUMENT = 100_000;

/** @param {object} value */
function jsonBody(value) {
  const json = JSON.stringify(value);
  const body = json.length <= MOST_ARGUMENT ? quoted(json) : `@- <<'END'\n${json}\nEND\n`;
  return `-H 'Content-Type: application/json' -d ${body}`;
}

/**
 * A curl command for a batch of the session.
 * @type {(sync: Page.Sync, name: string, media: string, body: object) => string}
 */
export const batchLine = (sync, name, media, body) =>
  `curl -sS ${addressOf(`sessions/${known(sync.session).id}/batch`)} -o ${quoted(name)}${keyHeader()} -H 'Accept: ${media}' ${jsonBody(body)}`;

/**
 * A curl command with the same result as "Download PNG", or as the export with `output`. It reads
 * the key from a variable; the copied text never contains it.
 * @param {Page.Sync} sync
 * @param {Page.State} state
 * @param {Page.Output} [output]
 */
export function curlLine(sync, { picture: open, document: bent }, output = {}) {
  const picture = known(open);
  const out = quoted(pictureName(picture.name, output.format));
  const object = warpOf(bent);
  const chosen = Object.keys(output).length ? { output: { ...object.output, ...output } } : {};
  const warp = quoted(JSON.stringify({ ...object, ...chosen }));
  const key = keyHeader();
  if (picture.linked) {
    const body = jsonBody({ q: wire(bent, "q"), ...(chosen.output && { output }) });
    return `curl -sS ${addressOf(`sessions/${known(sync.session).id}/warp`)} -o ${out}${key} ${body}`;
  }
  const mask = regionOf(bent).parts.length
    ? ` -F ${quoted(`region=@${formFile(regionName(picture.name))}`)}`
    : "";
  /** @type {(file: string) => string} */
  const form = (file) =>
    `curl -sS ${addressOf("warp")} -o ${out}${key} -F ${quoted(`image=@${file}`)} --form-string ${quoted("warp=").replaceAll("'", "")}${warp}${mask}`;
  if (picture.sample)
    return `curl -sS ${addressOf(picture.sample)} | ${form(`-;filename=${picture.name}`)}`;
  return form(formFile(picture.name));
}

/**
 * A curl command for a blend of files. `name`: that of the result.
 * @type {(files: { image: string, landmarks: string }[], blend: object, name: string, media:
 * string) => string}
 */
export function blendLine(files, blend, name, media) {
  /** @type {(part: string, file: string) => string} */
  const form = (part, file) => `-F ${quoted(`${part}=@${formFile(file)}`)}`;
  const parts = files.map(
    ({ image, landmarks }) => `${form("image", image)} ${form("landmarks", landmarks)}`,
  );
  const json = quoted(JSON.stringify(blend));
  return `curl -sS ${addressOf("blend")} -o ${quoted(name)}${keyHeader()} -H 'Accept: ${media}' ${parts.join(" ")} --form-string blend=${json}`;
}

/** @type {(text: string) => string} */
const toBase64Url = (text) => {
  const binary = Array.from(new TextEncoder().encode(text), (byte) =>
    String.fromCharCode(byte),
  ).join("");
  return btoa(binary).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
};

/** @type {(text: string) => string} */
const fromBase64Url = (text) =>
  new TextDecoder().decode(
    Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0)),
  );

/**
 * A link that reopens the session with the current pose.
 * @param {Page.Sync} sync
 * @param {Page.State} state
 */
export function linkTo(sync, { picture, document: bent }) {
  const parts = new URLSearchParams({
    session: known(sync.session).id,
    warp: toBase64Url(JSON.stringify(warpOf(bent))),
    name: known(picture).name,
  });
  return `${new URL(".", document.baseURI)}#${parts}`;
}

/**
 * Parses a link: { session, warp, name }; null if the text is not a link; `warp` is null if it is
 * damaged.
 * @param {string} hash
 * @returns {{ session: string, warp: Page.Json, name: string } | null}
 */
export function readLink(hash) {
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const session = parts.get("session");
  if (!session) return null;
  let warp = null;
  try {
    const told = parts.get("warp");
    warp = told === null ? undefined : JSON.parse(fromBase64Url(told));
  } catch {
    // Truncated or mistyped: the caller reports it.
  }
  return { session, warp, name: (parts.get("name") ?? "picture.png").slice(0, 200) };
}

/**
 * Copies text to the clipboard; if the browser refuses, shows and selects it for manual copying.
 * @param {string} text
 * @param {HTMLTextAreaElement} shown
 */
export async function copy(text, shown) {
  shown.value = text;
  try {
    await navigator.clipboard.writeText(text);
    shown.hidden = true;
    return true;
  } catch {
    shown.hidden = false;
    shown.focus();
    shown.select();
    return false;
  }
}
