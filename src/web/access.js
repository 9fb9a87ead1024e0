// The key that a server may want. It stays in this browser: in this tab's storage, or, where that is wished, in the browser's. It travels in a
// header, and in the socket's list of subprotocols, never in an address.

import { attempt } from "./keep.js";

const NAME = "mlswarp.key";
/** What a key may look like; the server says whether it is one. */
const SHAPE = /^[A-Za-z0-9._~+/=-]{16,512}$/;

let key = attempt(() => sessionStorage.getItem(NAME) ?? localStorage.getItem(NAME));

export const hasKey = () => key !== null;
export const isRemembered = () => attempt(() => localStorage.getItem(NAME)) !== null;
export const looksLikeKey = (text) => SHAPE.test(text);

/** From now on this key, or none. */
export function useKey(text, remember) {
  key = text;
  for (const [storage, keeps] of [[() => sessionStorage, !remember], [() => localStorage, remember]]) {
    attempt(() => (text !== null && keeps ? storage().setItem(NAME, text) : storage().removeItem(NAME)));
  }
}

export const keyHeaders = () => (key === null ? {} : { Authorization: `Bearer ${key}` });

/** A browser gives a WebSocket no headers. */
export const keyProtocols = () => (key === null ? [] : ["mlswarp", `mlswarp.bearer.${base64Url(key)}`]);

const base64Url = (text) => btoa(text).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
