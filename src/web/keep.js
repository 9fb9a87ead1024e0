// Persistence across reloads: the document in session storage (and in local storage, for a new
// tab), the file in IndexedDB, so that an expired session is opened again automatically.

const KEY = "mlswarp";
const STEPS = 50;
/**
 * Number of stored files: those of the last pictures, besides the ones that the undo history needs.
 */
const FILES = 4;

/** Storage may be disabled or full: then nothing is stored, and the page continues. */
export function attempt(what, otherwise = null) {
  try {
    return what();
  } catch {
    return otherwise;
  }
}

export const setting = (name) => attempt(() => localStorage.getItem(`${KEY}.${name}`));
export const keepSetting = (name, value) =>
  attempt(() => localStorage.setItem(`${KEY}.${name}`, value));

/** The state stored by this tab, otherwise by the last one. */
export const kept = () =>
  attempt(() => JSON.parse(sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY)));

export function forget() {
  attempt(() => sessionStorage.removeItem(KEY));
  attempt(() => localStorage.removeItem(KEY));
}

/**
 * Stores the document with all undo steps or, if storage is full, without them. Never leaves an
 * older document in the storage.
 */
function keepText(storage, text) {
  const keeps = (steps) => attempt(() => (storage.setItem(KEY, text(steps)), true), false);
  if (keeps(STEPS) || keeps(0)) return true;
  attempt(() => storage.removeItem(KEY));
  return false;
}

export class Keeper {
  kept = false;
  #timer = 0;

  /** `current`: returns the open picture (Opener). */
  constructor(store, current, told) {
    Object.assign(this, { current, told });
    store.subscribe((state, previous) => {
      if (
        ["document", "picture", "past", "earlier", "later"].every(
          (name) => state[name] === previous[name],
        )
      )
        return;
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.save(store.state), state.before ? 1000 : 100);
    });
    addEventListener("pagehide", () => this.save(store.state));
  }

  save(state) {
    clearTimeout(this.#timer);
    const { phase, earlier, later } = state;
    if (phase === "uploading" || (phase === "empty" && !earlier.length && !later.length)) return;
    const open = this.current();
    const text = (steps) => {
      const lastly = (past) => (steps ? past?.slice(-steps) : []);
      const short = (picture) => ({
        ...picture,
        past: lastly(picture.past),
        future: picture.future?.slice(0, steps),
        source: undefined,
        annotations: undefined,
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

function database() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open(KEY, 1);
    request.onupgradeneeded = () =>
      request.result.createObjectStore("files", { keyPath: "key", autoIncrement: true });
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

function settled(request) {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

/**
 * Stores a file; returns its key, or null if the browser refuses. Removes old files, except those
 * with a key in `needed`. Stores bytes: private windows of WebKit cannot store a Blob.
 */
export async function keepFile(blob, name, needed) {
  try {
    const bytes = await blob.arrayBuffer();
    const opened = await database();
    const files = opened.transaction("files", "readwrite").objectStore("files");
    const key = await settled(files.add({ bytes, type: blob.type, name }));
    const keys = await settled(files.getAllKeys());
    for (const old of keys.slice(0, -FILES).filter((old) => !needed.includes(old)))
      files.delete(old);
    opened.close();
    return key;
  } catch {
    return null;
  }
}

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
