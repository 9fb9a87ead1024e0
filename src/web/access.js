// The API key. It is stored in this browser only: for this tab or, on request, permanently. It is
// sent in a header and in the list of subprotocols of the socket, never in an address. A page in a
// frame has a session token of its site instead, which is not stored.

import { attempt } from "./keep.js";

const NAME = "mlswarp.key";
/** The syntax of a key; only the server knows whether it is valid. */
const SHAPE = /^[A-Za-z0-9._~+/=-]{16,512}$/;

/** @type {string | null} */
let key = attempt(() => sessionStorage.getItem(NAME) ?? localStorage.getItem(NAME));

/** Whether the server may know this key; an earlier visit of the page may have used a stored one. */
let isKnown = key !== null;

/**
 * The only session that the token is for.
 *
 * @type {string | null}
 */
let session = null;

export const hasKey = () => key !== null;
export const tokenSession = () => session;
export const isRemembered = () => attempt(() => localStorage.getItem(NAME)) !== null;
/** @type {(text: string) => boolean} */
export const looksLikeKey = (text) => SHAPE.test(text);

/** Notes that the server has answered a request with this key. */
export function acceptKey() {
  isKnown = key !== null;
}

/**
 * Sets the key; null removes it. Whether another one was in its place that had an account, as far
 * as the page can know: one that the server has never accepted had none.
 * @param {string | null} text
 * @param {boolean} remember
 */
export function useKey(text, remember) {
  const isOther = isKnown && key !== text;
  if (key !== text) isKnown = false;
  key = text;
  for (const { storage, keeps } of [
    { storage: () => sessionStorage, keeps: !remember },
    { storage: () => localStorage, keeps: remember },
  ]) {
    attempt(() =>
      text !== null && keeps ? storage().setItem(NAME, text) : storage().removeItem(NAME),
    );
  }
  return isOther;
}

/**
 * Uses a session token in place of a key; false if the text has another form. Only the server can
 * check it.
 *
 * @param {unknown} text
 */
export function useToken(text) {
  if (typeof text !== "string") return false;
  const claims = attempt(() => JSON.parse(atob(plainBase64(text.split(".")[1]))));
  if (typeof claims?.sid !== "string") return false;
  key = text;
  session = claims.sid;
  return true;
}

/** @type {() => Record<string, string>} */
export const keyHeaders = () => (key === null ? {} : { Authorization: `Bearer ${key}` });

/** Subprotocols with the key: a WebSocket in a browser cannot set headers. */
export const keyProtocols = () =>
  key === null ? [] : ["mlswarp", `mlswarp.bearer.${base64Url(key)}`];

/** @type {(text: string) => string} */
const plainBase64 = (text) => text.replaceAll("-", "+").replaceAll("_", "/");
/** @type {(text: string) => string} */
const base64Url = (text) => btoa(text).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
