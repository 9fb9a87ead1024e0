// What can be taken along: the picture, the handles, a command that repeats the picture, a link.

import { hasKey } from "./access.js";
import * as api from "./api.js";
import { warpOf, wire } from "./edits.js";

const stem = (name) => name.replace(/\.[^.]*$/, "") || "picture";
export const pictureName = (name) => `${stem(name)}-bent.png`;
export const handlesName = (name) => `${stem(name)}-handles.json`;

export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** The server's bytes of the document as it stands: those that are seen, else asked for. */
export async function bentPicture(sync, store) {
  await sync.settled();
  const { revision, document } = store.state;
  if (sync.png?.revision === revision) return sync.png.blob;
  return (await api.picture(sync.session.id, { q: wire(document, "q") })).blob;
}

/** The warp object, a handle a line. */
export function handlesText(document) {
  const { p, q, ...others } = warpOf(document);
  const list = (handles) => (handles.length ? `[\n${handles.map((h) => `    ${JSON.stringify(h)}`).join(",\n")}\n  ]` : "[]");
  const parts = [["p", list(p)], ["q", list(q)], ...Object.entries(others).map(([name, value]) => [name, JSON.stringify(value)])];
  return `{\n${parts.map(([name, text]) => `  "${name}": ${text}`).join(",\n")}\n}\n`;
}

/** In single quotes, for a POSIX shell. */
const quoted = (words) => (/^[\w@%+=:,./-]+$/.test(words) ? words : `'${words.replaceAll("'", "'\\''")}'`);

/** A file name in a form field of curl: in double quotes where curl would read a part of it as something else; `-` alone is its standard input. */
const formFile = (name) => (name === "-" ? "./-" : /[",;\\]|^\s|\s$/.test(name) ? `"${name.replace(/[\\"]/g, "\\$&")}"` : name);

/** A command that answers the bytes of "Download PNG". Whoever runs it has the key in a variable: it is never a part of what is copied. */
export function curlLine(sync, { picture, document: bent }) {
  const address = (path) => new URL(path, document.baseURI).href;
  const out = quoted(pictureName(picture.name));
  const warp = quoted(JSON.stringify(warpOf(bent)));
  const key = hasKey() ? ' -H "Authorization: Bearer $MLSWARP_KEY"' : "";
  if (picture.linked) {
    const body = quoted(JSON.stringify({ q: wire(bent, "q") }));
    return `curl -sS ${address(`sessions/${sync.session.id}/warp`)} -o ${out}${key} -H 'Content-Type: application/json' -d ${body}`;
  }
  const form = (file) => `curl -sS ${address("warp")} -o ${out}${key} -F ${quoted(`image=@${file}`)} --form-string ${quoted("warp=").replaceAll("'", "")}${warp}`;
  if (picture.sample) return `curl -sS ${address(picture.sample)} | ${form(`-;filename=${picture.name}`)}`;
  return form(formFile(picture.name));
}

const toBase64Url = (text) => {
  const binary = Array.from(new TextEncoder().encode(text), (byte) => String.fromCharCode(byte)).join("");
  return btoa(binary).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
};

const fromBase64Url = (text) => new TextDecoder().decode(Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0)));

/** A link that reopens the session as it is posed now. */
export function linkTo(sync, { picture, document: bent }) {
  const parts = new URLSearchParams({ session: sync.session.id, warp: toBase64Url(JSON.stringify(warpOf(bent))), name: picture.name });
  return `${new URL(".", document.baseURI)}#${parts}`;
}

/** What a link says: { session, warp, name }, null when it is none, a warp of null when it is broken. */
export function readLink(hash) {
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const session = parts.get("session");
  if (!session) return null;
  let warp = null;
  try {
    warp = parts.has("warp") ? JSON.parse(fromBase64Url(parts.get("warp"))) : undefined;
  } catch {
    // Cut off or mistyped: told by the one who opens it.
  }
  return { session, warp, name: (parts.get("name") ?? "picture.png").slice(0, 200) };
}

/** Puts text on the clipboard; where that is refused, it is shown, marked, to be copied by hand. */
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
