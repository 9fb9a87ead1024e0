// User-visible texts: problems, methods, alpha, folds, warnings, hints and limits.

import { hasFocus, infoOf, mayHave, metricOf, takesLinesOnly, takesPinsOnly } from "./edits.js";
import { METHODS } from "./methods.js";

const number = new Intl.NumberFormat("en", { maximumFractionDigits: 2, useGrouping: false });
/** @type {(list: Page.Place[]) => string} */
export const places = (list) =>
  list.map(([x, y]) => `${number.format(x)}, ${number.format(y)}`).join(" to ");
/** @type {(n: number, one: string, many?: string) => string} */
export const count = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;

/** @param {number} n */
export function bytes(n) {
  const [size, unit] =
    n >= 1 << 20 ? [n / (1 << 20), "MiB"] : n >= 1 << 10 ? [n / (1 << 10), "KiB"] : [n, "bytes"];
  return `${size >= 100 || unit === "bytes" ? Math.round(size) : size.toFixed(1).replace(/\.0$/, "")} ${unit}`;
}

/**
 * What the stage says while the shown picture is not the server's newest.
 * @type {Record<string, string>}
 */
export const BEHIND = {
  picture: "Preview: the server's picture is late",
  server: "Preview: the server does not respond",
};

/**
 * Title and advice by problem code. Other codes use the title of the server.
 * @type {Record<string, [title: string, advice: string]>}
 */
export const PROBLEMS = {
  network: [
    "The server does not respond",
    "Your handles are safe in this browser. Retrying automatically.",
  ],
  overloaded: ["The server is busy", "Retrying automatically."],
  unavailable: [
    "The server does not respond",
    "It is stopped or being updated. Retrying automatically.",
  ],
  stored_by_another_version: [
    "The server is being updated",
    "Another version of the server stored this picture. Retrying automatically.",
  ],
  misdirected: [
    "The server does not serve this host name",
    "Open the page as localhost, or add the name to --allowed-hosts.",
  ],
  rate_limited: ["Too many requests", "Retrying automatically."],
  timeout: ["The request timed out", "Retrying automatically. A smaller picture takes less time."],
  outside_mask: [
    "A handle lies beside the outline",
    "Handles stand on what the picture shows, unless they act across gaps (Deformation).",
  ],
  empty_mask: [
    "Nothing lies inside the outline",
    "Lower “Solid from”, or let handles act across gaps (Deformation).",
  ],
  too_many_vertices: [
    "The picture has too many pieces for a puppet",
    "Choose another method, or open a smaller picture.",
  ],
  unreachable: [
    "No picture without folds",
    "Handles cross or meet, so that every picture folds. Move them apart, or turn “Remove folds” off.",
  ],
  no_such_session: [
    "The session has expired",
    "Open the picture again: the server keeps it for a limited time, and this browser has no copy.",
  ],
  session_expired: [
    "The session has expired",
    "Open the picture again: the server keeps it for a limited time, and this browser has no copy.",
  ],
  no_such_layer: [
    "The region of the session was removed",
    "Open the link again: another user has changed the session.",
  ],
  too_large: [
    "Too large for this server",
    "Make it smaller, or ask the operator of the server for a higher limit.",
  ],
  unsupported_format: [
    "Unsupported file format",
    "Save the picture as PNG, JPEG, WebP, GIF, BMP or TIFF and open that file.",
  ],
  bad_landmarks: [
    "The landmark file cannot be read",
    "Correct the file at the place that the message names.",
  ],
  nothing_visible: [
    "Nothing of the picture is left",
    "The handles make it a line or a point: undo the last step, or choose another canvas.",
  ],
  bad_image: [
    "The picture cannot be read",
    "The file may be damaged or incomplete. Check whether it opens in another program.",
  ],
  contradictory_handles: [
    "Handles contradict each other",
    "They meet, but are moved apart. Put one of them back, or delete it.",
  ],
  degenerate_line: [
    "A line has no length",
    "Its points coincide at rest. Move one of them in the table, or delete the line.",
  ],
  alpha_out_of_range: ["Focus is out of range", "Choose a value on the slider, or Automatic."],
  shape_mismatch: [
    "The handles do not match",
    "Reload the page. If the problem persists, delete the marked handle.",
  ],
  not_finite: ["A number is too large", "Undo, or put the marked handle back."],
  bad_value: ["Invalid value", "Undo the last step."],
  forbidden: [
    "The server does not accept this key",
    "Enter another key, or ask the operator of the server.",
  ],
  token_expired: [
    "The permission to use this page has expired",
    "Reload the page of the site that shows it.",
  ],
  unauthorized: ["API key required", "Enter the key that you got from the operator of the server."],
  needs_server: ["This needs a server", "This page comes from a host without one."],
  no_engine: ["The engine cannot be loaded", "Reload the page, or use another browser."],
  internal: ["Internal server error", "Undo the last step, or try again."],
  unreadable: [
    "The browser cannot show this picture",
    "The service can warp it, but this page needs it as PNG or JPEG.",
  ],
  unreadable_file: [
    "The file cannot be opened",
    "It may have been moved or changed. Choose it again.",
  ],
  not_a_picture: [
    "No picture found",
    "Open a PNG, JPEG, WebP, GIF, BMP or TIFF file, a file with handles, landmarks or annotations, or a project.",
  ],
  bad_handles_file: [
    "The handles cannot be opened",
    "Correct the file, or save the handles again.",
  ],
  bad_annotations: [
    "The annotations cannot be used",
    "Correct the file, or save it again as GeoJSON in pixels of this picture.",
  ],
  bad_project: [
    "The project cannot be opened",
    "Ask for the file again, or save the project again.",
  ],
  dead_link: [
    "This link no longer works",
    "Ask for a new link or the project file. If you have the picture, open it here: the handles of the link are placed on it.",
  ],
  bad_link: ["The link is incomplete", "Ask for the link again, or open a picture."],
};

/**
 * Indices of the handles that a problem is about: the member `handle`, those that contradict each
 * other, and all that are beside the outline.
 * @param {Pick<Page.Problem, "handle" | "coincident" | "beside"> | null | undefined} problem
 * @returns {number[]}
 */
export function marked(problem) {
  if (problem?.handle === undefined) return [];
  return [
    ...new Set([
      ...(problem.beside ?? []),
      problem.handle,
      ...(problem.coincident ?? []).flatMap(({ handles }) => handles),
    ]),
  ];
}

/** Handles that a sentence lists. */
const MOST_LISTED = 8;

/** @type {(list: (string | number)[]) => string} */
const series = (list) =>
  list.length > 1 ? `${list.slice(0, -1).join(", ")} and ${list.at(-1)}` : `${list}`;

/**
 * Counts handles from 1 instead of 0, and rounds numbers.
 * @type {(detail: string) => string}
 */
const plain = (detail) =>
  detail
    .replace(
      /\b(handles?) (\d+(?:(?:, | and )\d+\b(?! more))*)/gi,
      (_, word, list) =>
        `${word} ${list.replace(/\d+/g, (/** @type {string} */ index) => String(Number(index) + 1))}`,
    )
    .replace(/\d+\.\d{3,}/g, (digits) => number.format(Number(digits)));

/** @param {Page.Problem} problem */
export function problemWords({
  code,
  title,
  detail: told,
  handle,
  coincident,
  beside = [],
  status,
  opening,
  link,
  request_id: id,
}) {
  // The detail of `unauthorized` describes a request header, which does not help here. Status 0:
  // the page's own words.
  const detail = code === "unauthorized" ? "" : status === 0 ? (told ?? "") : plain(told ?? "");
  const [said, usual] = PROBLEMS[link ? "dead_link" : code] ?? [
    title || "Request rejected",
    "Undo the last step, or try again.",
  ];
  // Only requests for the open picture are repeated automatically.
  const advice = opening
    ? usual.replace(
        /(Your handles are safe in this browser\. )?Retrying automatically\.|Undo the last step, or try again\./,
        "Try again.",
      )
    : usual;
  // A file with several specimens, images or persons: this page takes all of a file.
  const choose =
    code === "bad_landmarks" && /`item`/.test(told ?? "")
      ? "This page opens one set of landmarks: save the one that you need as a file of its own."
      : "";
  const more = code === "internal" && id ? ` Request ${id}.` : "";
  if (beside.length) return besideWords(beside);
  const marks = marked({ handle, coincident, beside });
  const where = marks.length ? ` Marked: ${series(marks.map((index) => index + 1))}.` : "";
  const sentence = detail
    ? `${detail[0].toUpperCase()}${detail.slice(1)}${/[.!?]$/.test(detail) ? "" : "."}`
    : "";
  return { title: said, detail: `${sentence}${more}`, advice: choose || `${advice}${where}` };
}

/**
 * What is said of handles beside the outline, and what the buttons do.
 * @param {number[]} beside
 */
function besideWords(beside) {
  const numbers = beside.map((index) => index + 1);
  const more = numbers.length - MOST_LISTED;
  const listed = more > 0 ? [...numbers.slice(0, MOST_LISTED), `${more} more`] : numbers;
  const isOne = beside.length === 1;
  return {
    title: isOne
      ? "A handle lies beside the outline"
      : `${beside.length} handles lie beside the outline`,
    detail: `${isOne ? "Handle" : "Handles"} ${series(listed)}: not, or not as a whole, on what the picture and its region show.`,
    advice:
      "Inside the outline, handles act along what the picture shows; across gaps, in the plane.",
  };
}

/** @type {(takes: (document: { method: Page.Method }) => boolean) => string[]} */
const titles = (takes) =>
  METHODS.filter(({ name }) => takes({ method: name })).map(({ title }) => title);
/** @type {(list: string[], verbs: [one: string, more: string]) => string} */
const theyDo = (list, verbs) => `${series(list)} ${verbs[list.length > 1 ? 1 : 0]}`;

/** About handles and the outline that they act in. */
export const OUTLINE = {
  beside: "Nothing inside the outline is near: put a handle on what the picture shows",
  leaves: "This line leaves the outline: draw a path along what the picture shows",
  /** @type {(moved: number) => string} */
  moved: (moved) =>
    moved === 1
      ? "Moved to the nearest place inside the outline"
      : `${count(moved, "handle")} moved to the nearest places inside the outline`,
};

/** Why no line, path, border or twist is made. */
export const PINS_ONLY = `${theyDo(titles(takesPinsOnly), ["takes", "take"])} pins without a twist only: choose another method first`;
/** Why no pin is made. */
export const LINES_ONLY = `${theyDo(titles(takesLinesOnly), ["takes", "take"])} lines and paths only: choose another method first`;

/**
 * The note about the method of a document, and which methods its handles may not have.
 * @param {Page.Document} document
 */
export function methodWords(document) {
  const { smoothing } = document;
  const { sentence, interpolates } = infoOf(document);
  const words = [sentence];
  if (takesPinsOnly(document)) words.push("For pins only.");
  if (takesLinesOnly(document)) words.push("For lines and paths only.");
  if (interpolates === "smoothing" && smoothing)
    words.push(`Smoothing ${smoothing}: it passes near the handles, not through them.`);
  /** @type {(takes: (document: { method: Page.Method }) => boolean) => string[]} */
  const shut = (takes) => titles((other) => takes(other) && !mayHave(document, other.method));
  const [pins, lines] = [shut(takesPinsOnly), shut(takesLinesOnly)];
  if (pins.length)
    words.push(`${theyDo(pins, ["is", "are"])} for pins only: not with lines, paths and twists.`);
  if (lines.length)
    words.push(`${theyDo(lines, ["is", "are"])} for lines and paths only: not with pins.`);
  return words.join(" ");
}

/**
 * Where handles act: the metrics.
 * @type {{ name: Page.Metric, title: string, sentence: string }[]}
 */
export const METRICS = [
  {
    name: "geodesic",
    title: "Inside the outline",
    sentence: "Handles act along what the picture shows: one leg bends without its neighbour.",
  },
  {
    name: "euclidean",
    title: "Across gaps",
    sentence: "Handles act in every direction: what lies near moves along.",
  },
];

/** @param {Page.Document} document */
export function metricWords(document) {
  if (!hasFocus(document)) return "This method reaches the whole picture, whatever lies between.";
  return METRICS.find(({ name }) => name === metricOf(document))?.sentence ?? "";
}

/**
 * Why no method can be chosen, or an empty text.
 * @param {number} pins
 * @param {boolean} pinsOnly
 * @param {number} least
 */
export function noFitWords(pins, pinsOnly, least) {
  if (!pinsOnly) return "Choosing compares pins: not with lines, paths and twists.";
  return pins < least ? `Choosing takes ${least} pins or more.` : "";
}

/** @type {(length: number) => string} */
const px = (length) => `${length < 9.95 ? length.toFixed(1) : Math.round(length)} px`;

/** @param {Page.FitBest} candidate */
function candidateName({ method, alpha, smoothing }) {
  const parameter = alpha ? `focus ${alpha}` : smoothing ? `smoothing ${smoothing}` : "";
  return `${infoOf({ method }).title}${parameter && ` (${parameter})`}`;
}

/**
 * Why a method was chosen. `before`: the method until then.
 * @param {{ best: Page.FitBest, candidates: Page.FitCandidate[], before: Page.Method, outliers:
 * number[], scale: number }} told
 */
export function fitWords({ best, candidates, before, outliers, scale }) {
  const ranked = candidates.toSorted((a, b) => a.rms - b.rms);
  const other =
    ranked.find(({ method }) => method === before && before !== best.method) ??
    ranked.find(({ method }) => method !== best.method);
  const against = other ? `; ${candidateName(other)}: ${px(other.rms)}` : "";
  const wrong = outliers.length
    ? ` Check ${outliers.length > 1 ? "pins" : "pin"} ${series(outliers.map((index) => index + 1))}: far from where the others put ${outliers.length > 1 ? "them" : "it"}.`
    : "";
  const drawn = ` Arrows lead from the prediction to the pin${scale > 1 ? `, ${scale} times as long` : ""}.`;
  return `${candidateName(best)} predicts left-out pins best: ${px(ranked[0].rms)} on average (RMS)${against}.${wrong}${drawn}`;
}

/**
 * What is known about a pin whose residual is shown.
 * @type {(residual: Page.Place, outlier: boolean) => string}
 */
export const residualWords = ([x, y], outlier) =>
  `, ${px(Math.hypot(x, y))} from its prediction${outlier ? ", an outlier" : ""}`;

export const CANVAS = {
  same: "Shows the area of the picture.",
  fit: "Shows the whole result, however far it extends.",
  box: "Shows this box, in px of the picture; x and y may be negative.",
};

/**
 * What lies outside the canvas; empty if nothing does.
 * @param {{ left: number, top: number, right: number, bottom: number }} cut
 */
export function cutWords({ left, top, right, bottom }) {
  /** @type {[number, string][]} */
  const sides = [
    [left, "on the left"],
    [right, "on the right"],
    [top, "above"],
    [bottom, "below"],
  ];
  const cut = sides.filter(([length]) => length > 0);
  return cut.length
    ? `Of the result, ${series(cut.map(([length, where]) => `${length} px ${where}`))} lie outside.`
    : "";
}

export const OUTSIDE = {
  transparent: "Transparent outside the warped picture.",
  edge: "Extends the edge pixels outside the warped picture.",
  reflect:
    "Mirrors the picture at its warped border. During a drag, the edge pixels are extended instead.",
  colour: "Fills the outside of the warped picture with this colour.",
  value: "Fills the outside of the warped picture with this value of the file's own depth.",
};

export const FILTER = {
  nearest: "Takes the nearest pixel: no new colours, jagged edges. For masks and pixel art.",
  bilinear: "Blends the pixels around each place.",
  bicubic: "Sharper than bilinear, slower.",
};

/** Texts about the region. */
export const REGION = {
  none: "The whole picture moves. Draw around what may move with Lasso, or paint over it with Brush: everything else then stays as it is.",
  some: "Only the region moves, as it is at rest. Everything else stays as it is.",
  /** @param {string} name */
  needs: (name) => `The command needs the file ${name}`,
};

export const HOLES = {
  keep: "Where the region has moved away, the picture stays visible.",
  transparent: "Where the region has moved away, the result is transparent.",
};

export const PLAY = { noWebgl: "Playing needs WebGL, which this browser does not have." };

/** @param {number} alpha */
export function focusWords(alpha) {
  if (alpha < 0.95) return "Wide: each handle affects the whole picture.";
  if (alpha < 1.35) return "Balanced: the influence of a handle falls off slowly with distance.";
  if (alpha < 2.25) return "Tight: each handle affects mainly its surroundings.";
  return "Very tight: each handle affects only its own position, with sharp changes in between.";
}

/** @param {number} n */
export function foldWords(n) {
  if (!n) return "";
  return `${count(n, "cell")} of the mesh ${n === 1 ? "folds" : "fold"}: the picture overlaps itself where it is red. Move the handles there less, or add a handle between them.`;
}

/** Texts of the export dialog. */
export const EXPORT = {
  cancelled: "Cancelled",
  names: { png: "PNG", jpeg: "JPEG", webp: "WebP", animation: "animation" },
  formats: {
    png: "Lossless, with transparency.",
    jpeg: "Small files for photographs; not lossless, without transparency.",
    webp: "Lossless, with transparency; often smaller than PNG.",
    animation: "The way from rest to the pose, as one file.",
  },
  compressions: {
    fast: "Quick to prepare.",
    best: "The smallest file; takes longer to prepare.",
    none: "The largest file.",
  },
  backgrounds: {
    transparent: "JPEG has no transparency: transparent pixels get this colour.",
    edge: "JPEG has no transparency: transparent pixels become white.",
    reflect: "JPEG has no transparency: transparent pixels become white.",
    colour: "JPEG has no transparency: transparent pixels get the colour chosen for the outside.",
    value: "JPEG has no transparency: transparent pixels get the value chosen for the outside.",
  },
};

/** Texts of the dialog "Average or morph". */
export const BLEND = {
  /** @type {Record<string, string>} */
  files: {
    png: "PNG",
    jpeg: "JPEG",
    apng: "animated PNG",
    gif: "GIF",
    zip: "zip of the frames",
  },
  uploading: "Uploading.",
  preparing: "Preparing the file",
  waits: "Waits to be uploaded",
  bothSides: "Landmarks of one picture are expected, and the file has those of two.",
  /** @param {number} most */
  large: (most) => `The file is larger than ${bytes(most)}.`,
  /** @param {string[]} names */
  unused: (names) => (names.length ? `Not used: ${series(names)}.` : ""),
  /** @param {string} stem */
  needs: (stem) => `Needs its landmark file, such as ${stem}.pts or ${stem}.csv`,
  /** @type {(name: string, n: number) => string} */
  landmarks: (name, n) => `${count(n, "landmark")} from ${name}`,
  /** @type {(used: number, all: number, landmarks: number) => string} */
  count: (used, all, landmarks) =>
    all === 0
      ? ""
      : used < all
        ? `${used} of ${count(all, "picture")} can be used.`
        : `${count(used, "picture")}, ${count(landmarks, "landmark")} each.`,
  /** @param {string[]} names */
  note: (names) =>
    names.length === 1
      ? "Half of the picture and half of its mirror image: a symmetric one."
      : `0 % is ${names[0]}, 100 % ${names.length === 2 ? names[1] : "the mean of the others"}. Below 0 % and above 100 % differences are exaggerated.`,
  /** @type {(names: string[], shares: number[], isMirrored: boolean) => string} */
  picture: (names, [shape, colour], isMirrored) =>
    `Blend of ${names.length > 4 ? count(names.length, "picture") : series(names)}${isMirrored ? " and mirror images" : ""}: shape ${Math.round(100 * shape)} %, colours ${Math.round(100 * colour)} %`,
};

/** Texts about landmark files with several specimens, images, persons or rows. */
export const ITEMS = {
  /** @type {(names: string[], k: number) => string} */
  label: (names, k) => {
    const longest = names.filter((name) => !names.some((n) => n !== name && n.includes(name)));
    return [`${k + 1}.`, ...longest].join(" ");
  },
  /** @type {(file: string, n: number, picture: string) => string} */
  note: (file, n, picture) => `${file} has ${n} sets of landmarks. Choose the one for ${picture}.`,
  /** @type {(listed: number) => string} */
  more: (listed) => `The first ${listed} are listed. Another one: its number or its name`,
};

/** Texts of the export as an animation. */
export const ANIMATION = {
  /** @type {Record<Page.Animation["file"], (back: boolean) => string>} */
  notes: {
    apng: (back) =>
      `${back ? "The frames of the way back are added. " : ""}Browsers show an animated PNG like a picture.`,
    gif: (back) =>
      `${back ? "The frames of the way back are added. " : ""}At most 256 colours per frame, and shown everywhere.`,
    zip: (back) => `${back ? "The frames of the way back are added. " : ""}Each frame is a PNG.`,
  },
  /** @param {number} seconds */
  session: (seconds) => `It works until ${spanOf(seconds)} after the last request`,
};

/** @type {Record<string, string>} */
export const WARNINGS = {
  affine_degenerate_used_similarity: "Too few or collinear handles for affine: similarity is used.",
  tps_degenerate_used_similarity:
    "The handles lie on a line: the picture turns and scales with it.",
  translation_only: "One handle: the whole picture is moved.",
  rotation_undefined: "The handles do not define a rotation: none is applied.",
  near_duplicate_handles: "Two handles are almost at the same position.",
  coincident_handles:
    "Handles at the same position are moved apart: the picture follows their mean.",
  line_alpha_below_one: "With a focus below 1, lines can deviate between their ends.",
  tolerance_exceeded:
    "Some details are less precise than usual, because the picture changes too abruptly there.",
  handles_outside_picture: "A handle is far outside the picture.",
  looks_normalized:
    "The units do not fit the picture: pixels and fractions of its size look mixed up.",
  annotations_outside_picture:
    "Annotations are far outside the picture, or in other units than the handles.",
  nothing_visible: "The whole picture is outside the canvas.",
  mirrored: "The picture is mirrored.",
  folds_remain: "Some folds could not be removed.",
  mask_is_everything: "The picture has no outline: handles act in every direction.",
  mirrored_use_affine:
    "The handles mirror the picture, which this method cannot. Choose Affine or Spline.",
  scaled_use_similarity:
    "The handles change the size of the picture, which Rigid cannot. Choose Similarity.",
  handles_missing: "Handles without a position are left out.",
  landmarks_unmatched: "Landmarks that only one file has are left out.",
  profile_dropped:
    "The result says less about its colours than the picture: they may look different.",
  metadata_dropped: "The result lacks some of the picture's metadata.",
  file_repaired: "The picture's file is damaged where no pixel is: the picture is complete.",
};

/** @type {Record<string, string>} */
export const STAGES = {
  queue: "Queue",
  decode: "Decoding",
  plan: "Plan",
  reduce: "Scaled copies",
  deform: "Deformation",
  render: "Rendering",
  encode: "PNG encoding",
};

export const HINTS = {
  first: { mouse: "Click to place a pin, then drag it", touch: "Tap to place a pin, then drag it" },
  sample: {
    mouse: "Drag a handle, or click to place another pin",
    touch: "Drag a handle, or tap to place another pin",
  },
  one: {
    mouse: "One handle moves everything. Click to pin the parts that should stay",
    touch: "One handle moves everything. Tap to pin the parts that should stay",
  },
  line: { mouse: "Drag a line, or click its two ends", touch: "Drag a line, or tap its two ends" },
  path: {
    mouse: "Click the points of the path; double-click the last one",
    touch: "Tap the points of the path, then Finish",
  },
  lasso: {
    mouse: "Draw around what may move, or click its corners",
    touch: "Draw around what may move, or tap its corners",
  },
  brush: { mouse: "Paint over what may move", touch: "Paint over what may move" },
  move: { mouse: "Click the target position", touch: "Tap the target position" },
};

/** @param {Page.Waiting} waiting */
export function waitingWords({ handles, annotations }) {
  const parts = [
    handles?.later && `${handles.name} ${handles.later.length > 1 ? "have" : "has"} landmarks.`,
    handles &&
      !handles.later &&
      `${handles.name} has ${count(handles.document.handles.length, "handle")}.`,
    annotations && `${annotations.name} has annotations.`,
  ];
  const isOne = !annotations && handles?.document.handles.length === 1;
  return `${parts.filter(Boolean).join(" ")} Choose the picture or sample that ${isOne ? "it belongs" : "they belong"} to.`;
}

/** @type {(name: string, n: number) => string} */
export const annotationWords = (name, n) =>
  `${name}: ${count(n, "annotation")}, moved with the picture.`;

/**
 * About the files that were opened with others, and not used.
 * @type {(names: string[]) => string}
 */
export const unusedWords = (names) =>
  `Not used: ${series(names)}. One picture, two landmark files and one GeoJSON file are opened at a time.`;

export const ALIGN = {
  none: "The pose is where its file or you have put it.",
  rigid:
    "The pose is moved and turned to fit the rest positions best. Editing a handle applies this.",
  similarity:
    "The pose is moved, turned and scaled to fit the rest positions best. Editing a handle applies this.",
  affine:
    "The pose is moved, turned, stretched and sheared to fit the rest positions best. Editing a handle applies this.",
};

/** @type {(seconds: number) => string} */
const spanOf = (seconds) =>
  seconds < 60 ? count(Math.round(seconds), "second") : count(Math.round(seconds / 60), "minute");

/**
 * Until when a link to a session works.
 * @param {{ expires: string }} session
 */
export function linkWords({ expires }) {
  const [end, now] = [new Date(expires), new Date()];
  const day =
    end.toDateString() === now.toDateString()
      ? ""
      : `${end.toLocaleDateString("en", { day: "numeric", month: "long" })}, `;
  const time = end.toLocaleTimeString("en", { hour: "2-digit", minute: "2-digit", hour12: false });
  return `It works until ${day}${time}, and for ${spanOf((Number(end) - Number(now)) / 1000)} after each use.`;
}

/**
 * A link to a session that has ended.
 * @type {(name: string, idle: number | null) => string}
 */
export const deadLinkWords = (name, idle) =>
  idle === null
    ? `The link to ${name} leads to a picture on a server, and this page works without one.`
    : `The link to ${name} has ended: the server deletes a picture ${spanOf(idle)} after its last use.`;

/** What is said where the engine in the browser takes the place of a server. */
export const NEEDS_SERVER = {
  one: "This needs a server: the page works without one here",
  option: "needs a server",
  start: "This page works without a server: pictures stay in this browser. What is grey needs one.",
  late: "Preview: the exact picture is late",
  /** @type {typeof PROBLEMS} */
  problems: {
    too_large: ["Too large for this page", "Make it smaller."],
    internal: ["The engine has failed", "Undo the last step, or open a smaller picture."],
    no_such_session: ["The picture is not open any more", "Open it again."],
  },
  all: "This page works without a server. Averages and morphs, animations as zip, “Choose for me”, alignment, the exact map of annotations, links and commands need one.",
};

/**
 * @param {Page.Limits} limits
 * @param {boolean} isKept whether a server keeps the picture
 */
export function limitWords({ body, pixels, idle, memory }, isKept) {
  const minutes = Math.round(idle / 60);
  const time = minutes >= 1 ? count(minutes, "idle minute") : count(idle, "idle second");
  const taken = `PNG, JPEG, WebP, GIF, BMP or TIFF, up to ${bytes(body)} and ${number.format(pixels / 1e6)} megapixels.`;
  if (!isKept) return taken;
  return `${taken} The server keeps it${memory ? " in memory only" : ""} and deletes it after ${time}.`;
}
