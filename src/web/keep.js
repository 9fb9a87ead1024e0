// Persistence across reloads: the document in session storage (and in local storage, for a new
// tab), the file in IndexedDB, so that an expired session is opened again automatically.

const KEY = "mlswarp";
const STEPS = 50;
/** Number of stored files: those of four pictures (pictures.js), each with its annotations. */
const FILES = 8;

/**
 * Storage may be disabled or full: then nothing is stored, and the page continues.
 * @template T
 * @param {() => T} what
 * @returns {T | null}
 */
export function attempt(what) {
  try {
    return what();
  } catch {
    return null;
  }
}

/** @type {(name: string) => string | null} */
export const setting = (name) => attempt(() => localStorage.getItem(`${KEY}.${name}`));
/** @type {(name: string, value: string) => unknown} */
export const keepSetting = (name, value) =>
  attempt(() => localStorage.setItem(`${KEY}.${name}`, value));

/**
 * The state stored by this tab, otherwise by the last one.
 * @type {() => Page.Json}
 */
export const kept = () =>
  attempt(() => JSON.parse(sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY) ?? "null"));

export function forget() {
  attempt(() => sessionStorage.removeItem(KEY));
  attempt(() => localStorage.removeItem(KEY));
}

/**
 * Stores the document with all undo steps or, if storage is full, without them. Never leaves an
 * older document in the storage.
 * @param {Storage} storage
 * @param {(steps: number) => string} text
 */
function keepText(storage, text) {
  /** @type {(steps: number) => boolean | null} */
  const keeps = (steps) => attempt(() => (storage.setItem(KEY, text(steps)), true));
  if (keeps(STEPS) || keeps(0)) return true;
  attempt(() => storage.removeItem(KEY));
  return false;
}

export class Keeper {
  kept = false;
  #timer = 0;

  /**
   * `current`: returns the open picture (Opener).
   * @param {Page.Store} store
   * @param {() => Page.Kept} current
   * @param {() => void} told
   */
  constructor(store, current, told) {
    this.current = current;
    this.told = told;
    store.subscribe((state, previous) => {
      if (
        /** @type {const} */ ([
          "document",
          "picture",
          "past",
          "earlier",
          "later",
          "annotations",
        ]).every((name) => state[name] === previous[name])
      )
        return;
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.save(store.state), state.before ? 1000 : 100);
    });
    addEventListener("pagehide", () => this.save(store.state));
  }

  /** @param {Page.State} state */
  save(state) {
    clearTimeout(this.#timer);
    const { phase, earlier, later } = state;
    if (phase === "uploading" || (phase === "empty" && !earlier.length && !later.length)) return;
    const open = this.current();
    /** @type {(steps: number) => string} */
    const text = (steps) => {
      /** @type {(past: Page.Document[] | undefined) => Page.Document[] | undefined} */
      const lastly = (past) => (steps ? past?.slice(-steps) : []);
      /** @type {(picture: Page.Kept) => object} */
      const short = (picture) => ({
        ...picture,
        past: lastly(picture.past),
        future: picture.future?.slice(0, steps),
        source: undefined,
        // They are a file of their own.
        annotations: picture.annotations && { ...picture.annotations, geojson: undefined },
      });
      return JSON.stringify({
        ...short(open),
        earlier: earlier.map(short),
        later: later.map(short),
      });
    };
    this.kept = keepText(sessionStorage, text) && phase === "open" && open.file !== null;
    keepText(localStorage, text);
    this.told();
  }
}

/** @returns {Promise<IDBDatabase>} */
function database() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open(KEY, 1);
    request.onupgradeneeded = () =>
      request.result.createObjectStore("files", { keyPath: "key", autoIncrement: true });
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

/**
 * @template T
 * @param {IDBRequest<T>} request
 * @returns {Promise<T>}
 */
function settled(request) {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

/**
 * Stores a file; returns its key, or null if the browser refuses. Removes the oldest files beyond
 * `FILES`, except those with a key in `needed`. Stores bytes: private windows of WebKit cannot store a Blob.
 * @param {Blob} blob
 * @param {string} name
 * @param {IDBValidKey[]} needed
 * @returns {Promise<IDBValidKey | null>}
 */
export async function keepFile(blob, name, needed) {
  try {
    const bytes = await blob.arrayBuffer();
    const opened = await database();
    const files = opened.transaction("files", "readwrite").objectStore("files");
    const key = await settled(files.add({ bytes, type: blob.type, name }));
    const keys = await settled(files.getAllKeys());
    const spare = keys.filter((old) => !needed.includes(old));
    for (const old of spare.slice(0, Math.max(0, keys.length - FILES))) files.delete(old);
    opened.close();
    return key;
  } catch {
    return null;
  }
}

/** @param {IDBValidKey[]} keys */
export async function forgetFiles(keys) {
  try {
    const opened = await database();
    const files = opened.transaction("files", "readwrite").objectStore("files");
    for (const key of keys) await settled(files.delete(key));
    opened.close();
  } catch {
    // Nothing was stored.
  }
}

/**
 * Annotations as they were: after a reload, those of the stored file; null if it is gone.
 * @param {Page.Annotations | null | undefined} annotations
 * @returns {Promise<Page.Annotations | null>}
 */
export async function keptAnnotations(annotations) {
  if (!annotations || annotations.geojson !== undefined) return annotations ?? null;
  const file = await keptFile(annotations.key);
  return file && { ...annotations, geojson: JSON.parse(await file.blob.text()) };
}

/**
 * @param {IDBValidKey | null | undefined} key
 * @returns {Promise<Page.Source | null>}
 */
export async function keptFile(key) {
  if (key === null || key === undefined) return null;
  try {
    const opened = await database();
    const found = await settled(opened.transaction("files").objectStore("files").get(key));
    opened.close();
    // Earlier versions of the page stored a Blob.
    return found
      ? { blob: found.blob ?? new Blob([found.bytes], { type: found.type }), name: found.name }
      : null;
  } catch {
    return null;
  }
}
