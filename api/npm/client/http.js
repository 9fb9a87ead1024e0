// Requests: the key or token, the time that they may take, and which are sent again.

import { jsonOf } from "../engine/json.js";
import { ApiError, ConnectionFailed } from "./errors.js";

/**
 * @typedef {{
 *   server: string | URL,
 *   auth?: string | (() => string | Promise<string>),
 *   fetch?: typeof fetch,
 *   WebSocket?: typeof WebSocket,
 *   timeout?: number,
 *   maxRetries?: number,
 * }} ClientOptions
 */

/**
 * @template T
 * @typedef {{
 *   json?: object,
 *   body?: BodyInit,
 *   accept?: string,
 *   type?: string,
 *   keepalive?: boolean,
 *   retries?: number,
 *   signal?: AbortSignal | null,
 *   read: (response: Response) => T | Promise<T>,
 * }} Asked
 */

/** Answers after which a request is sent again. Not 409 (a newer pose won) and not 410. */
const AGAIN = new Set([408, 429, 502, 503, 504]);
/** Pauses before it, s: doubled with each, at a random time of its second half. */
const [FIRST, LONGEST] = [0.5, 8];
/** A longer `Retry-After` is left to the caller, s. */
const PATIENCE = 120;

/**
 * A pause that ends with the signal, whose reason it throws.
 *
 * @param {number} ms
 * @param {AbortSignal} [signal]
 * @returns {Promise<void>}
 */
export function pause(ms, signal) {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(signal.reason);
    const ended = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", ended);
      resolve();
    }, ms);
    signal?.addEventListener("abort", ended, { once: true });
  });
}

/** The connection to one server. */
export class Http {
  /** @type {string | (() => string | Promise<string>) | undefined} */
  #auth;
  /**
   * The key or token, or the question for it.
   *
   * @type {Promise<string> | null}
   */
  #credential = null;

  /** @param {ClientOptions} options */
  constructor({ server, auth, timeout = 60_000, maxRetries = 2, ...ways }) {
    /** Without the slash at its end. */
    this.server = String(server).replace(/\/+$/, "");
    if (!/^https?:\/\//.test(this.server))
      throw new TypeError(`server: an address that begins with http:// or https://, not ${server}`);
    this.#auth = auth;
    this.timeout = timeout;
    this.maxRetries = maxRetries;
    this.fetch = ways.fetch ?? ((/** @type {Parameters<typeof fetch>} */ ...all) => fetch(...all));
    this.WebSocket = ways.WebSocket ?? globalThis.WebSocket;
  }

  /** The key or token of the next request, if there is one. A function is asked once. */
  async credential() {
    if (typeof this.#auth !== "function") return this.#auth;
    const ask = this.#auth;
    this.#credential ??= Promise.resolve().then(ask);
    try {
      return await this.#credential;
    } catch (error) {
      this.#credential = null;
      throw error;
    }
  }

  /** The next request asks the function again. False if `auth` is not a function. */
  forget() {
    this.#credential = null;
    return typeof this.#auth === "function";
  }

  /**
   * Sends a request, again if that may help, and reads its answer within the time limit.
   *
   * @template T
   * @param {string} method
   * @param {string} path
   * @param {Asked<T>} asked
   * @returns {Promise<T>}
   */
  async ask(method, path, asked) {
    let isRenewed = false;
    for (let tries = 0; ; tries++) {
      try {
        return await this.#once(method, path, asked);
      } catch (error) {
        if (asked.signal?.aborted) throw asked.signal.reason;
        if (!(error instanceof ApiError || error instanceof ConnectionFailed)) throw error;
        if (error.code === "token_expired" && !isRenewed && this.forget()) {
          isRenewed = true;
          tries -= 1;
          continue;
        }
        const wait = tries < (asked.retries ?? this.maxRetries) ? pauseAfter(error, tries) : null;
        if (wait === null) throw error;
        await pause(1000 * wait, asked.signal ?? undefined);
      }
    }
  }

  /**
   * @template T
   * @param {string} method
   * @param {string} path
   * @param {Asked<T>} asked
   * @returns {Promise<T>}
   */
  async #once(method, path, { json, body, accept, type, keepalive, signal, read }) {
    const credential = await this.credential();
    signal?.throwIfAborted();
    /** @type {Record<string, string>} */
    const headers = {};
    if (credential) headers.Authorization = `Bearer ${credential}`;
    if (accept) headers.Accept = accept;
    if (json || type) headers["Content-Type"] = type ?? "application/json";
    // The limit is for the answer as `read` takes it: a stream is read without one.
    const limit = new AbortController();
    const timer = setTimeout(() => limit.abort(), this.timeout);
    try {
      const response = await this.fetch(`${this.server}/${path}`, {
        method,
        headers,
        body: json ? jsonOf(json) : body,
        keepalive,
        cache: "no-store",
        signal: signal ? AbortSignal.any([signal, limit.signal]) : limit.signal,
      });
      if (!response.ok) throw await ApiError.from(response);
      return await read(response);
    } catch (error) {
      if (error instanceof ApiError) throw error;
      if (signal?.aborted) throw signal.reason;
      if (limit.signal.aborted)
        throw new ConnectionFailed("no_answer", `no answer within ${this.timeout} ms`, error);
      throw new ConnectionFailed("network", `no answer from ${this.server}`, error);
    } finally {
      clearTimeout(timer);
    }
  }

  /**
   * Opens a socket. A browser cannot set its headers, so the key is one of the subprotocols.
   *
   * @param {string} path
   */
  async socket(path) {
    const credential = await this.credential();
    if (!this.WebSocket)
      throw new TypeError("this platform has no WebSocket: pass one, such as that of `ws`");
    const protocols = credential ? ["mlswarp", `mlswarp.bearer.${base64Url(credential)}`] : [];
    const socket = new this.WebSocket(`ws${this.server.slice(4)}/${path}`, protocols);
    socket.binaryType = "arraybuffer";
    return socket;
  }
}

/**
 * Seconds until a request is sent again; null: it is not.
 *
 * @param {ApiError | ConnectionFailed} error
 * @param {number} tries
 */
function pauseAfter(error, tries) {
  if (error instanceof ApiError) {
    if (!AGAIN.has(error.status)) return null;
    if (error.retryAfter !== undefined)
      return error.retryAfter <= PATIENCE ? error.retryAfter + Math.random() / 4 : null;
  }
  return (Math.min(LONGEST, FIRST * 2 ** tries) * (1 + Math.random())) / 2;
}

/** @param {string} text */
const base64Url = (text) => btoa(text).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");

/**
 * Reads JSON.
 *
 * @param {Response} response
 * @returns {Promise<any>}
 */
export const json = (response) => response.json();
