// Persistence across reloads: the document in session storage (and in local storage, for a new tab), the file in IndexedDB, so that an
// expired session is opened again automatically.

const KEY = "mlswarp";
const STEPS = 50;
/** Number of stored files: those of the last pictures. */
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
export const keepSetting = (name, value) => attempt(() => localStorage.setItem(`${KEY}.${name}`, value));

/** The state stored by this tab, otherwise by the last one. */
export const kept = () => attempt(() => JSON.parse(sessionStorage.getItem(KEY) ?? localStorage.getItem(KEY)));

export function forget() {
  attempt(() => sessionStorage.removeItem(KEY));
  attempt(() => localStorage.removeItem(KEY));
}

/** Stores the document with all undo steps or, if storage is full, without them. Never leaves an older document in the storage. */
function keepText(storage, text) {
  const keeps = (steps) => attempt(() => (storage.setItem(KEY, text(steps)), true), false);
  if (keeps(STEPS) || keeps(0)) return true;
  attempt(() => storage.removeItem(KEY));
  return false;
}

export class Keeper {
  kept = false;
  #timer = 0;

  /** `whole`: returns the session state to store, or null. */
  constructor(store, whole, told) {
    Object.assign(this, { whole, told });
    store.subscribe((state, previous) => {
      if (state.document === previous.document && state.picture === previous.picture && state.past === previous.past) return;
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.save(store.state), state.before ? 1000 : 100);
    });
    addEventListener("pagehide", () => this.save(store.state));
  }

  save(state) {
    clearTimeout(this.#timer);
    const more = state.phase === "open" ? this.whole() : null;
    if (!more) return;
    const document = state.before ?? state.document;
    const text = (steps) =>
      JSON.stringify({ ...more, picture: state.picture, document, past: steps ? state.past.slice(-steps) : [], future: state.future.slice(0, steps) });
    this.kept = keepText(sessionStorage, text) && more.file !== null;
    keepText(localStorage, text);
    this.told();
  }
}

function database() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open(KEY, 1);
    request.onupgradeneeded = () => request.result.createObjectStore("files", { keyPath: "key", autoIncrement: true });
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

/** Stores a file; returns its key, or null if the browser refuses. Stores bytes: private windows of WebKit cannot store a Blob. */
export async function keepFile(blob, name) {
  try {
    const bytes = await blob.arrayBuffer();
    const opened = await database();
    const files = opened.transaction("files", "readwrite").objectStore("files");
    const key = await settled(files.add({ bytes, type: blob.type, name }));
    const keys = await settled(files.getAllKeys());
    for (const old of keys.slice(0, -FILES)) files.delete(old);
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
    return found ? { blob: found.blob ?? new Blob([found.bytes], { type: found.type }), name: found.name } : null;
  } catch {
    return null;
  }
}
