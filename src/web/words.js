// Texts: what the page says of problems, methods, reach, folds and keys, in plain words.

const number = new Intl.NumberFormat("en", { maximumFractionDigits: 2, useGrouping: false });
export const places = (list) => list.map(([x, y]) => `${number.format(x)}, ${number.format(y)}`).join(" to ");
export const count = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;

export function bytes(n) {
  const [size, unit] = n >= 1 << 20 ? [n / (1 << 20), "MiB"] : n >= 1 << 10 ? [n / (1 << 10), "KiB"] : [n, "bytes"];
  return `${size >= 100 || unit === "bytes" ? Math.round(size) : size.toFixed(1).replace(/\.0$/, "")} ${unit}`;
}

/** What is wrong and what to do, by code. The server's own title and detail stand where nothing is said here. */
const PROBLEMS = {
  network: ["The server does not answer", "Your handles are safe in this browser. Trying again by itself."],
  overloaded: ["The server has its hands full", "Trying again by itself in a moment."],
  stored_by_another_version: ["The server is being updated", "Another version of it keeps this picture. Trying again by itself."],
  misdirected: ["This server does not answer at this address", "Open it as localhost, or add the name to --allowed-hosts."],
  rate_limited: ["Too many requests at once", "Trying again by itself in a moment."],
  timeout: ["That took too long", "Trying again by itself. A smaller picture is quicker."],
  no_such_session: ["The session has ended", "Open the picture again: the server keeps it for a while only, and this browser has no copy."],
  session_expired: ["The session has ended", "Open the picture again: the server keeps it for a while only, and this browser has no copy."],
  too_large: ["That is too large for this server", "Make it smaller, or ask whoever runs the server for a higher limit."],
  unsupported_format: ["This is not a picture that can be read here", "Save it as PNG, JPEG or WebP and open that."],
  bad_image: ["The picture cannot be read", "The file seems damaged or incomplete. See whether it opens elsewhere."],
  contradictory_handles: ["Two handles want different things", "Put one of them back, or delete it."],
  degenerate_line: ["A line has no length", "Its places rest on each other. Move one of them apart in the table, or delete it."],
  alpha_out_of_range: ["Focus is out of range", "Choose a value on the slider, or Automatic."],
  shape_mismatch: ["The handles do not match", "Reload the page; if it stays, delete the handle that is marked."],
  not_finite: ["A number is too large", "Undo, or put the marked handle back."],
  bad_value: ["A value is not taken", "Undo the last step."],
  forbidden: ["This server does not take your key", "Give another one, or ask whoever runs the server."],
  unauthorized: ["This server wants a key", "Give the one that you have from whoever runs the server."],
  internal: ["Something went wrong on the server", "Undo the last step, or try again."],
  unreadable: ["The browser cannot show this picture", "It can still be bent by the service; here, save it as PNG or JPEG first."],
  unreadable_file: ["The file cannot be opened", "It may have been moved or changed. Choose it again."],
  not_a_picture: ["Nothing here is a picture", "PNG, JPEG and WebP files can be opened."],
  bad_link: ["This link is incomplete", "Ask for it again, or open a picture yourself."],
};

/** Which handles a problem is about: the one that it names as a member, and a second one that only its words have. */
export function marked(problem) {
  if (problem?.handle === undefined) return [];
  const [, a, b] = /\bhandles (\d+) and (\d+)/i.exec(problem.detail ?? "") ?? [];
  return [...new Set([problem.handle, ...(b === undefined ? [] : [Number(a), Number(b)])])];
}

/** The server counts handles from 0 and gives every digit; people do neither. */
const plain = (detail) =>
  detail
    .replace(/\b(handles?) (\d+)(?: and (\d+))?/gi, (_, word, a, b) => `${word} ${Number(a) + 1}${b === undefined ? "" : ` and ${Number(b) + 1}`}`)
    .replace(/\d+\.\d{3,}/g, (digits) => number.format(Number(digits)));

export function problemWords({ code, title, detail: told, handle, request_id: id }) {
  // How a program sends its key helps nobody here.
  const detail = code === "unauthorized" ? "" : plain(told ?? "");
  const [said, advice] = PROBLEMS[code] ?? [title || "That was refused", "Undo the last step, or try again."];
  const more = code === "internal" && id ? ` Request ${id}.` : "";
  const marks = marked({ handle, detail: told });
  const where = marks.length ? ` Marked: ${marks.map((index) => index + 1).join(" and ")}.` : "";
  const sentence = detail ? `${detail[0].toUpperCase()}${detail.slice(1)}${/[.!?]$/.test(detail) ? "" : "."}` : "";
  return { title: said, detail: `${sentence}${more}`, advice: `${advice}${where}` };
}

export const METHODS = {
  rigid: "Keeps shapes as they are, like cardboard: it turns and shifts, nothing grows or shrinks.",
  similarity: "May grow and shrink, but keeps angles: good for making something larger or smaller.",
  affine: "May also stretch and slant: follows the handles most freely.",
};

export const OUTSIDE = {
  transparent: "Nothing where the picture does not reach.",
  edge: "Its edge goes on where the picture does not reach.",
  colour: "This colour where the picture does not reach.",
};

export function focusWords(alpha) {
  if (alpha < 0.95) return "Wide: each handle is felt across the picture.";
  if (alpha < 1.35) return "Balanced: felt far away, but less and less.";
  if (alpha < 2.25) return "Tight: each handle rules its surroundings.";
  return "Very tight: each handle rules its own place, with quick changes in between.";
}

export function foldWords(n) {
  if (!n) return "";
  return `${count(n, "cell")} of the mesh ${n === 1 ? "folds" : "fold"} over: the picture overlaps itself where it is red. Move the handles there less far, or add one between them.`;
}

export const WARNINGS = {
  affine_degenerate_used_similarity: "Too few or collinear handles for affine: similarity is used.",
  translation_only: "One handle: the whole picture is shifted.",
  rotation_undefined: "The handles say nothing of a turn: none is made.",
  near_duplicate_handles: "Two handles lie almost on each other.",
  line_alpha_below_one: "Focus below 1 lets lines slip between their ends.",
  nothing_visible: "The whole picture lies outside the canvas.",
  profile_dropped: "The picture's colour profile cannot be used: its colours may look different.",
};

export const STAGES = { queue: "Waiting", decode: "Reading", plan: "Plan", deform: "Bending", render: "Drawing", encode: "Writing PNG" };

export const HINTS = {
  first: { mouse: "Click to pin a place, then drag it", touch: "Tap to pin a place, then drag it" },
  sample: { mouse: "Drag a handle, or click to pin another place", touch: "Drag a handle, or tap to pin another place" },
  one: { mouse: "One handle moves everything. Click to pin what should stay", touch: "One handle moves everything. Tap to pin what should stay" },
  line: { mouse: "Drag a line, or click its two ends", touch: "Drag a line, or tap its two ends" },
  path: { mouse: "Click the places of the path; double-click the last", touch: "Tap the places of the path, then Finish" },
  move: { mouse: "Click where it should go", touch: "Tap where it should go" },
};

export function limitWords({ body, pixels, idle, memory }) {
  const minutes = Math.round(idle / 60);
  const time = minutes >= 1 ? count(minutes, "idle minute") : count(idle, "idle second");
  return `PNG, JPEG or WebP, up to ${bytes(body)} and ${number.format(pixels / 1e6)} megapixels. The server keeps it${memory ? " in memory only" : ""} and forgets it after ${time}.`;
}
