// The entry point: creates the store, the views and the inputs, and publishes the observable state
// (README.md).

import * as api from "./api.js";
import { hasKey, isRemembered, looksLikeKey, tokenSession, useKey } from "./access.js";
import { alignOf } from "./align.js";
import { Actions } from "./actions.js";
import { Player } from "./player.js";
import { BlendDialog } from "./blend.js";
import { CanvasRuler, canvasOf } from "./canvas.js";
import { find, findAll, known, listen, part } from "./dom.js";
import { filterOf, outsideOf, takesLinesOnly, takesPinsOnly } from "./edits.js";
import { Annotations } from "./annotations.js";
import { ExportDialog } from "./export.js";
import { ANNOTATIONS, HANDLES, PICTURES } from "./files.js";
import { chooseMethod } from "./fit.js";
import { askForToken, listenToSite } from "./frame.js";
import { Handles } from "./handles.js";
import { Keeper, forget, keepSetting, kept, setting } from "./keep.js";
import { Keys } from "./keys.js";
import { Notices } from "./notices.js";
import { Opener } from "./open.js";
import { Loupe } from "./loupe.js";
import { Panel } from "./panel.js";
import { isRegionTool, regionOf } from "./region.js";
import { RegionTool } from "./regiontool.js";
import { Pointer } from "./pointer.js";
import { projectText } from "./project.js";
import { does as service, limits, prepare } from "./service.js";
import {
  warpedPicture,
  annotationsName,
  copy,
  curlLine,
  handlesName,
  handlesText,
  landmarksName,
  landmarksText,
  linkTo,
  pictureName,
  projectName,
  readLink,
  save,
  saveRegion,
} from "./share.js";
import { Store, steps } from "./state.js";
import { shownStrength } from "./strength.js";
import { StrengthSlider } from "./slider.js";
import { Sync } from "./sync.js";
import { Table } from "./table.js";
import { View } from "./view.js";
import { BEHIND, LINES_ONLY, PINS_ONLY, REGION, limitWords, linkWords } from "./words.js";

const queryFields = new URLSearchParams(location.search);

const stage = find("stage");
const store = new Store();
const view = new View(stage, queryFields.get("webgl") !== "off");
const sync = new Sync(
  store,
  view,
  service.transport && queryFields.get("socket") !== "off",
  service.transport && queryFields.get("plan") !== "off",
);
const handles = new Handles(find("handles"), store, view);
const actions = new Actions(store, sync, view, handles, say, (back) => opener.step(back), toast);
const opener = new Opener(
  store,
  sync,
  view,
  actions,
  limits,
  () => keeper.save(store.state),
  toast,
);
const exporting = new ExportDialog(store, sync, limits, toast);
const blending = new BlendDialog(limits, () => observe());
const loupe = new Loupe(find("loupe"), view, () => find("loupe-wanted").checked);
const region = new RegionTool(store, view, actions);
const pointer = new Pointer(stage, store, view, handles, actions, loupe, region);

/**
 * Announces a text to screen readers; a newer text replaces it.
 *
 * @param {string} words
 */
function say(words) {
  find("says").textContent = words;
}

let toasting = 0;
/** @param {string} words */
function toast(words) {
  const node = find("toast");
  node.textContent = words;
  node.classList.add("seen");
  clearTimeout(toasting);
  toasting = setTimeout(() => node.classList.remove("seen"), 2600);
}

// It would cover what is wrong, and the buttons there.
store.subscribe(({ problem }, previous) => {
  if (problem && !previous.problem) find("toast").classList.remove("seen");
});

const KEYS = new Set(["unauthorized", "forbidden", "token_expired"]);
const RETRIES = new Set([
  "network",
  "overloaded",
  "unavailable",
  "stored_by_another_version",
  "rate_limited",
  "timeout",
  "internal",
]);

/** Problems of handles and the outline that they act in. */
const OUTLINED = new Set(["outside_mask", "empty_mask"]);

/**
 * Opens the browser's file chooser.
 *
 * @param {string} accept
 */
function choose(accept) {
  Object.assign(find("file"), { accept }).click();
}

/**
 * Actions shared by buttons and keys.
 *
 * @type {Page.Does}
 */
const does = {
  pick: () => choose([PICTURES, HANDLES, ANNOTATIONS].join()),
  pickHandles: () => choose(HANDLES),
  close: () => opener.close(),
  export: () => exporting.show(),
  help: () => find("help").showModal(),
  key: () => showKey(),
  tool: (tool) =>
    (tool === "line" || tool === "path") && takesPinsOnly(store.state.document)
      ? toast(PINS_ONLY)
      : tool === "point" && takesLinesOnly(store.state.document)
        ? toast(LINES_ONLY)
        : store.do("tool", { tool }),
  mesh: () => store.do("show", { what: { meshShown: !store.state.meshShown } }),
  removes: (removes) => store.do("show", { what: { removes } }),
  compare: () => {
    if (isRegionTool(store.state.tool)) does.tool("point");
    store.do("show", { what: { compare: !store.state.compare, arm: "", draft: [] } });
  },
  play: () => player.toggle(),
  arm: () => store.do("arm", { arm: store.state.arm ? "" : "move" }),
  fit: async () => {
    try {
      await chooseMethod(store, sync, view, actions);
    } catch (error) {
      store.do("problem", { problem: api.asProblem(error) });
    }
  },
  full: () => view.zoomTo(1 / view.scale),
  /** The label of the action that resolves a problem, or null. */
  mending: ({ code, opening, canMoveInside }) => {
    if (code === "no_such_session" || code === "session_expired") return "Open a picture";
    // The site around the frame gives tokens; a visitor has nothing to enter.
    if (KEYS.has(code)) return tokenSession() ? null : "Enter a key";
    if (RETRIES.has(code)) return "Try again";
    if (canMoveInside) return "Move inside";
    if (OUTLINED.has(code)) return "Act across gaps";
    return !opening && store.state.past.length ? "Undo" : null;
  },
  alternative: ({ canMoveInside, beside }) => {
    if (canMoveInside) return "Act across gaps";
    return beside.length ? "Delete marked" : null;
  },
  mend: (problem, action) => {
    if (action === "Open a picture") does.pick();
    else if (action === "Enter a key") does.key();
    else if (action === "Try again") (problem.opening ? opener : sync).retry();
    else if (action === "Move inside") actions.moveInside();
    else if (action === "Act across gaps") actions.actAcross();
    else if (action === "Delete marked") actions.removeThose(problem.beside);
    else actions.undo(true);
  },
};

new Panel(store, sync, view, actions, does);
new CanvasRuler(store, view, sync);
new StrengthSlider(find("strength"), find("strength-value"), store, actions);
new Table(find("handle-table"), store, actions);
const annotations = new Annotations(store, view, sync, () => observe());
new Notices(store, actions);
new Keys(stage, store, view, handles, pointer, actions, does, () => find("keys").checked);
const player = new Player(store, sync, view);
const keeper = new Keeper(store, () => opener.current, observe);

// Passes the state to the view.
store.subscribe((state, previous) => {
  const { meshShown: lines, compare, compareAt: at, tool } = state;
  const peek = state.peek || isRegionTool(tool);
  if (
    lines !== previous.meshShown ||
    compare !== previous.compare ||
    at !== previous.compareAt ||
    state.peek !== previous.peek ||
    tool !== previous.tool
  )
    view.show({ lines, compare, at, peek });
  view.setOutside(outsideOf(state.document));
  view.setFilter(filterOf(state.document));
  view.setCanvas(canvasOf(state.document));
  stage.classList.toggle("armed", Boolean(state.arm || state.draft.length));
});

/** Writes the observable state to `document.body.dataset`. */
function observe() {
  const { state } = store;
  const { shown } = sync;
  const observed = {
    state: sync.condition,
    revision: state.revision,
    shown: shown.revision ?? "",
    source: view.source === "source" ? "source" : shown.source,
    moving: state.before !== null,
    live: sync.live.way,
    plan: sync.lattice ? `${sync.lattice.columns},${sync.lattice.rows}` : "",
    behind: sync.behind,
    blend: blending.condition,
    webgl: view.webgl,
    handles: state.document.handles.length,
    selected: state.selection.length,
    tool: state.tool,
    region: regionOf(state.document).parts.length,
    draft: state.draft.length,
    arm: state.arm,
    strength: shownStrength(state),
    align: alignOf(state.document),
    annotations: annotations.shown,
    playing: typeof state.playing === "number" || (state.playing ?? false),
    ...steps(state),
    folds: shown.folds,
    residual: shown.residual?.toFixed(2) ?? "",
    zoom: view.zoom,
    canvas: view.size ? view.box.join() : "",
    pan: view.pan.map((c) => c.toFixed(2)).join(),
    progress: Math.round(state.progress),
    session: sync.session?.id ?? "",
    problem: state.problem?.code ?? "",
    kept: keeper.kept,
  };
  find("behind").textContent = BEHIND[observed.behind] ?? "";
  for (const [name, value] of Object.entries(observed))
    if (document.body.dataset[name] !== String(value)) document.body.dataset[name] = String(value);
}
store.subscribe(observe);
sync.subscribe(observe);
view.subscribe(observe);

// After a click, a tool or a button returns the focus to the stage, so that the arrow keys work.
// Keyboard focus stays.
for (const bar of findAll(
  "body > header, #work > .tools, #work > .zoom, #selection, #draft, #region-bar, #panel .buttons",
)) {
  const giveBack = () =>
    bar.contains(document.activeElement) &&
    store.state.phase === "open" &&
    stage.focus({ preventScroll: true });
  bar.addEventListener("click", ({ detail, target }) => {
    if (detail === 0) return;
    giveBack();
    // A label focuses its radio button after this. What has the focus otherwise was given it since.
    const control = target instanceof Element ? target.closest("label")?.control : null;
    if (control) setTimeout(() => document.activeElement === control && giveBack());
    document.querySelector("dialog[open]")?.addEventListener("close", giveBack, { once: true });
  });
}
// The mark leads to the start page, like "Close".
part(document, "h1 a").addEventListener("click", (event) => {
  if (event.ctrlKey || event.metaKey || event.shiftKey || store.state.phase !== "open") return;
  event.preventDefault();
  does.close();
});

// The focus never stays on a hidden control: it moves to the picture or, on the start page, to
// where it was or to the first button.
/** @type {(node: HTMLElement | null, phase: Page.Phase) => node is HTMLElement} */
const staysAt = (node, phase) =>
  node !== null &&
  node !== document.body &&
  node.checkVisibility() &&
  (phase !== "open" || node.matches(":focus-visible"));
/** @type {HTMLElement | null} */
let left = null;
store.subscribe(({ phase }, { phase: before }) => {
  if (phase === before) return;
  const activeElement = /** @type {HTMLElement | null} */ (document.activeElement);
  if (before === "empty" && phase === "uploading") left = activeElement;
  if (phase === "uploading" || staysAt(activeElement, phase)) return;
  (phase === "open" ? stage : staysAt(left, phase) ? left : find("pick")).focus({
    preventScroll: true,
  });
});

// Files

/**
 * Opens files, for a blend or as a picture.
 *
 * @param {FileList | null | undefined} list
 */
function take(list) {
  // The list of a field is emptied with it.
  const files = [...(list ?? [])];
  if (blending.takes(files)) blending.add(files);
  else opener.files(files);
}
listen("file", "change", (input) => {
  take(input.files);
  input.value = "";
});
for (const button of findAll("[data-sample]"))
  button.addEventListener("click", () =>
    opener.sample(/** @type {Parameters<Opener["sample"]>[0]} */ (button.dataset.sample)),
  );
find("upload-cancel").addEventListener("click", () => opener.cancel());

/** @type {(event: DragEvent) => boolean | undefined} */
const carriesFiles = (event) => event.dataTransfer?.types.includes("Files");
let inside = 0;
addEventListener(
  "dragenter",
  (event) => carriesFiles(event) && (find("over").hidden = ++inside < 1),
);
addEventListener(
  "dragleave",
  (event) => carriesFiles(event) && (find("over").hidden = --inside < 1),
);
addEventListener("dragover", (event) => carriesFiles(event) && event.preventDefault());
addEventListener("drop", (event) => {
  if (!carriesFiles(event)) return;
  event.preventDefault();
  inside = 0;
  find("over").hidden = true;
  take(event.dataTransfer?.files);
});
addEventListener(
  "paste",
  (event) => event.clipboardData?.files.length && take(event.clipboardData.files),
);

// Export

/**
 * Runs an action on the open picture; shows the problem if the server rejects it.
 *
 * @type {(act: (state: Page.State & { picture: Page.Picture }) => unknown) => () => Promise<void>}
 */
const taking = (act) => async () => {
  try {
    const { picture } = store.state;
    if (picture) await act({ ...store.state, picture });
  } catch (error) {
    store.do("problem", { problem: api.asProblem(error) });
  }
};
// A command or a link contains the session id, which may change with the handles: wait until the
// server has them.
/**
 * @type {(words: (sync: Page.Sync, state: Page.State) => string, what: string) => () =>
 * Promise<void>}
 */
const copying = (words, what) =>
  taking(async () => {
    await sync.settled();
    const copied = await copy(words(sync, store.state), find("copied"));
    const mask = words === curlLine ? await saveRegion(store.state) : null;
    toast(
      `${copied ? `${what} copied` : `Press Ctrl+C to copy the ${what.toLowerCase()}`}${mask ? `. ${REGION.needs(mask)}` : ""}`,
    );
  });
/** @param {string} text */
const json = (text) => new Blob([text], { type: "application/json" });
find("download").addEventListener(
  "click",
  taking(async (state) => save(await warpedPicture(sync, store), pictureName(state.picture.name))),
);
find("save-handles").addEventListener(
  "click",
  taking(async (state) => save(json(await handlesText(state)), handlesName(state.picture.name))),
);
find("save-landmarks").addEventListener(
  "click",
  taking((state) =>
    save(
      new Blob([landmarksText(state.document)], { type: "text/csv" }),
      landmarksName(state.picture.name),
    ),
  ),
);
find("copy-curl").addEventListener("click", copying(curlLine, "Command"));
const copyLink = copying(linkTo, "Link");
find("copy-link").addEventListener("click", async () => {
  await copyLink();
  await taking(async () => {
    const words = linkWords(await api.readSession(known(sync.session).id));
    find("link-note").textContent = words;
    if (find("copied").hidden) toast(`Link copied. ${words}`);
  })();
});
find("save-project").addEventListener(
  "click",
  taking(async (state) =>
    save(json(await projectText(state, known(sync.file))), projectName(state.picture.name)),
  ),
);
find("annotations-save").addEventListener(
  "click",
  taking(async ({ annotations: shown }) =>
    save(
      new Blob([JSON.stringify(await annotations.mapped())], { type: "application/geo+json" }),
      annotationsName(known(shown).name),
    ),
  ),
);

// Theme, help, panel

const THEMES = ["auto", "light", "dark"];
/** @param {string} theme */
function showTheme(theme) {
  document.body.dataset.theme = theme;
  const button = find("theme");
  button.setAttribute("aria-label", `Theme: ${theme}`);
  button.title = `Theme: ${theme}`;
  part(button, "use").setAttribute("href", `#i-${theme}`);
}
const chosen = setting("theme");
showTheme(chosen && THEMES.includes(chosen) ? chosen : "auto");
find("theme").addEventListener("click", () => {
  const next = THEMES[(THEMES.indexOf(document.body.dataset.theme ?? "") + 1) % THEMES.length];
  keepSetting("theme", next);
  showTheme(next);
});

find("help-open").addEventListener("click", does.help);
find("help-close").addEventListener("click", () => find("help").close());
find("help").addEventListener(
  "click",
  (event) => event.target === find("help") && find("help").close(),
);
for (const [id, name] of /** @type {const} */ ([
  ["keys", "keys"],
  ["loupe-wanted", "loupe"],
])) {
  find(id).checked = setting(name) !== "off";
  listen(id, "change", ({ checked }) => keepSetting(name, checked ? "on" : "off"));
}

// The key

function showKey() {
  find("help").close();
  find("key-field").value = "";
  find("key-remember").checked = isRemembered();
  find("key-forget").hidden = !hasKey();
  find("key-wrong").hidden = true;
  find("key").showModal();
}
/**
 * Uses a key and retries a request that was rejected without it. Only the server knows whether it
 * accepts the key.
 *
 * @param {string | null} key null: none
 * @param {boolean} remember
 */
async function takeKey(key, remember) {
  const isOther = useKey(key, remember);
  find("key").close();
  const { problem } = store.state;
  // The other key may belong to another person, even if the server refuses it by now.
  const forgot = isOther && (await opener.forgetAnnotations());
  /** @type {(words: string) => void} */
  const tell = (words) =>
    toast(forgot ? `${words}. Annotations are closed: they were of the other key` : words);
  if (key === null || !KEYS.has(problem?.code ?? ""))
    return tell(key === null ? "Key removed" : "Key saved in this browser");
  await repeat(problem);
  if (!store.state.problem) tell("The server accepts the key");
  else if (forgot) tell("Another key");
}
/**
 * Repeats a request that was rejected without permission.
 *
 * @param {Page.Problem | null} problem
 */
async function repeat(problem) {
  store.do("problem", { problem: null });
  if (problem?.opening) return opener.retry();
  sync.retry();
  await sync.settled();
}
find("key-open").addEventListener("click", does.key);
find("key-close").addEventListener("click", () => find("key").close());
find("key-forget").addEventListener("click", () => takeKey(null, false));
find("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const key = find("key-field").value.trim();
  find("key-wrong").hidden = looksLikeKey(key);
  if (looksLikeKey(key)) takeKey(key, find("key-remember").checked);
});

listen("panel-toggle", "click", (button) => {
  const open = document.body.classList.toggle("panel-open");
  button.setAttribute("aria-expanded", String(open));
});

// In a frame of another site

listenToSite((image) => {
  const { problem } = store.state;
  if (image) opener.file(image, image.name);
  else if (KEYS.has(problem?.code ?? "")) repeat(problem);
});
store.subscribe(({ problem }, previous) => {
  if (problem?.code === "token_expired" && problem !== previous.problem) askForToken();
});

// Restore the last state, or open the link in the address.

find("file").accept = [PICTURES, HANDLES, ANNOTATIONS].join();
find("limits").textContent = limitWords(limits, service.links);
function begin() {
  const before = kept();
  const link = readLink(location.hash) && location.hash;
  if (link && before?.link !== link) opener.openLink(link);
  else if (before)
    opener.restore(before).then(() => store.state.problem?.code === "session_expired" && forget());
}
addEventListener(
  "hashchange",
  () => readLink(location.hash) && location.hash !== opener.link && opener.openLink(location.hash),
);
observe();
prepare();
begin();
