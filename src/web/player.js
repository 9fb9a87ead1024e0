// Plays between the rest pose and the shown pose. The meshes of some strengths are fetched first,
// and those between them are interpolated here: nothing is requested while it plays, and the
// document does not change.

import * as api from "./api.js";
import { find, known, listen, part } from "./dom.js";
import { wire } from "./edits.js";
import { keepSetting, setting } from "./keep.js";
import { Mesh } from "./mesh.js";
import { posesOf } from "./strength.js";
import { PLAY } from "./words.js";

/**
 * The easings of the server: the share of the way as a function of the share of the time.
 * @type {Record<Page.Animation["easing"], (t: number) => number>}
 */
export const EASINGS = { linear: (t) => t, "ease-in-out": (t) => t * t * (3 - 2 * t) };
/** The number of equal parts of the way, at whose ends meshes are fetched. */
const MESH_PARTS = 8;
/** Time of one way, ms. */
export const TIME = 1500;
/**
 * The longest step of time between two frames, ms: a slow browser plays more slowly instead of
 * skipping frames.
 */
const LONGEST_STEP_MS = 200;
/** Stills that replace the motion of one way if the user prefers reduced motion. */
const STILL_COUNT = 5;

const STORED = "animation";
export const MOST_FRAMES = 10_000;

/**
 * The stored settings; invalid ones are left out.
 * @returns {Partial<Page.Animation>}
 */
function storedSettings() {
  /** @type {Record<string, (value: Page.Json) => boolean>} */
  const valid = {
    easing: (v) => v in EASINGS,
    back: (v) => typeof v === "boolean",
    frames: (v) => Number.isInteger(v) && v >= 2 && v <= MOST_FRAMES,
    file: (v) => ["apng", "gif", "zip"].includes(v),
  };
  let stored = {};
  try {
    stored = JSON.parse(setting(STORED) ?? "null") ?? {};
  } catch {
    // Damaged: the defaults apply.
  }
  return Object.fromEntries(Object.entries(stored).filter(([name, value]) => valid[name]?.(value)));
}

export class Player {
  /** @type {{ document: Page.Document | null, list: Page.Mesh[] }} */
  #meshes = { document: null, list: [] };

  /**
   * @param {Page.Store} store
   * @param {Page.Sync} sync
   * @param {Page.View} view
   */
  constructor(store, sync, view) {
    this.store = store;
    this.sync = sync;
    this.view = view;
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    store.do("animation", { change: storedSettings() });
    find("play").addEventListener("click", () => this.toggle());
    listen("play-easing", "change", ({ value }) =>
      store.do("animation", {
        change: { easing: /** @type {Page.Animation["easing"]} */ (value) },
      }),
    );
    listen("play-back", "change", ({ checked }) =>
      store.do("animation", { change: { back: checked } }),
    );
    store.subscribe((state, previous) => this.#follow(state, previous));
    this.#draw(store.state);
  }

  toggle() {
    if (this.store.state.playing !== null) this.stop();
    else if (!find("play").disabled && !this.store.state.before) this.#play();
  }

  stop() {
    this.store.do("play", { playing: null });
  }

  /**
   * A change of the document ends the animation.
   * @param {Page.State} state
   * @param {Page.State} previous
   */
  #follow(state, previous) {
    if (state.animation !== previous.animation)
      keepSetting(STORED, JSON.stringify(state.animation));
    if (state.playing !== null && state.document !== previous.document) this.stop();
    if (state.playing === null && previous.playing !== null) this.view.play(null);
    this.#draw(state);
  }

  async #play() {
    const {
      document,
      animation: { easing, back },
    } = this.store.state;
    this.store.do("play", { playing: "preparing" });
    const isMine = () =>
      this.store.state.playing !== null && this.store.state.document === document;
    try {
      await this.#fetch(document);
    } catch (error) {
      if (!isMine()) return;
      this.stop();
      return this.store.do("problem", { problem: api.asProblem(error) });
    }
    const { goal } = posesOf(document);
    let [time, last] = [0, performance.now()];
    // There and back begins and ends at the pose, so that nothing jumps.
    /** @type {(now: number) => void} */
    const frame = (now) => {
      if (!isMine()) return;
      time += Math.min(LONGEST_STEP_MS, Math.max(0, now - last)) / TIME;
      last = now;
      if (time > (back ? 2 : 1)) return this.stop();
      const shareOfTime = back ? Math.abs(1 - time) : time;
      const share = EASINGS[easing](
        this.still.matches
          ? Math.round(shareOfTime * (STILL_COUNT - 1)) / (STILL_COUNT - 1)
          : shareOfTime,
      );
      this.store.do("play", { playing: Math.round(100 * share * goal) / 100 });
      this.view.play(this.#meshAt(share));
      requestAnimationFrame(frame);
    };
    if (isMine()) frame(last);
  }

  /**
   * Fetches the meshes of a document.
   * @param {Page.Document} document
   */
  async #fetch(document) {
    if (this.#meshes.document === document) return;
    const list = await this.sync.ask(async (id) => {
      const { grid } = known(this.sync.session);
      const { at } = posesOf(document);
      /** @type {(k: number) => Promise<Page.Mesh>} */
      const meshAt = async (k) =>
        new Mesh(grid, (await api.mesh(id, { q: wire(at((k + 1) / MESH_PARTS), "q") })).places);
      return [
        Mesh.atRest(grid),
        ...(await Promise.all(Array.from({ length: MESH_PARTS }, (_, k) => meshAt(k)))),
      ];
    });
    this.#meshes = { document, list };
  }

  /** @param {number} share */
  #meshAt(share) {
    const before = Math.min(MESH_PARTS - 1, Math.floor(share * MESH_PARTS));
    const { list } = this.#meshes;
    return list[before].towards(list[before + 1], share * MESH_PARTS - before);
  }

  /** @param {Page.State} state */
  #draw({ playing, animation, document: { handles } }) {
    const words = playing === null ? "Play" : "Stop";
    const button = find("play");
    const shown = known(button.lastElementChild);
    if (shown.textContent !== words) {
      shown.textContent = words;
      part(button, "use").setAttribute("href", `#i-${words.toLowerCase()}`);
    }
    const canPlay = this.view.webgl !== "none";
    button.disabled = !handles.length || !canPlay;
    find("play-easing").value = animation.easing;
    find("play-back").checked = animation.back;
    find("play-note").textContent = canPlay ? "" : PLAY.noWebgl;
  }
}
