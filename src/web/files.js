// Files that a user opens together: what each of them is, and which are used. The others are named.

import { isAnnotations } from "./annotations.js";
import { Problem } from "./api.js";
import { beginsAsProject } from "./project.js";

const PICTURE = /\.(png|jpe?g|webp|gif|bmp|tiff?)$/i;
const TEXT = /\.(json|geojson|csv|tsv|pts|tem|tps|points|txt|xml|fcsv)$/i;
const MEDIA = /^(text\/(plain|csv|xml|tab-separated-values)|application\/(json|geo\+json|xml))$/;

/** For file choosers: media types, and names, because browsers do not know them all. */
export const PICTURES =
  "image/png,image/jpeg,image/webp,image/gif,image/bmp,image/tiff,.png,.jpg,.jpeg,.webp,.gif,.bmp,.tif,.tiff";
export const HANDLES =
  "application/json,.json,text/csv,.csv,.tsv,.pts,.tem,.tps,.points,.txt,.xml,.fcsv";
export const ANNOTATIONS = "application/geo+json,.geojson";

/** @typedef {"picture" | "project" | "annotations" | "handles" | "landmarks" | "other"} FileKind */

/** @type {(a: File, b: File) => number} */
const byName = (a, b) => a.name.localeCompare(b.name, "en", { numeric: true });

/** @type {(file: File) => boolean} */
const isPicture = (file) => file.type.startsWith("image/") || PICTURE.test(file.name);

/**
 * A copy in memory: the file on disk may change or disappear before it is read, and a browser then
 * refuses to read it. Throws a Problem.
 * @param {File} file
 */
export async function inMemory(file) {
  try {
    return new File([await file.arrayBuffer()], file.name, { type: file.type });
  } catch {
    const detail = file.name && `The browser cannot read ${file.name}.`;
    throw new Problem({ code: "unreadable_file", detail }, 0);
  }
}

/**
 * The JSON value of a file; undefined if it is not JSON or too large.
 * @param {File} file
 * @param {number} most
 * @returns {Promise<Page.Json>}
 */
async function valueOf(file, most) {
  if (file.size > most) return undefined;
  try {
    return JSON.parse(await file.text());
  } catch {
    return undefined;
  }
}

/**
 * `picture`, `project`, `annotations`, `handles` (complete, with both sides), `landmarks` or
 * `other`.
 * @param {File} file
 * @param {number} most
 * @returns {Promise<FileKind>}
 */
async function kindOf(file, most) {
  if (isPicture(file)) return "picture";
  if (!MEDIA.test(file.type) && !TEXT.test(file.name)) return "other";
  const value =
    /json/.test(file.type) || /json$/i.test(file.name) ? await valueOf(file, most) : undefined;
  // A damaged one is known by its start. One that is too large to be in memory may be unreadable.
  const start = await file
    .slice(0, 100)
    .text()
    .catch(() => "");
  if (value?.mlswarp_project !== undefined || beginsAsProject(start)) return "project";
  if (isAnnotations(value) || /\.geojson$/i.test(file.name)) return "annotations";
  return value?.p && value.q ? "handles" : "landmarks";
}

/**
 * Pictures, landmark files and others, in the order of their names, by names and media types alone.
 * @param {Iterable<File>} list
 */
export function paired(list) {
  /** @type {{ pictures: File[], landmarks: File[], others: File[] }} */
  const found = { pictures: [], landmarks: [], others: [] };
  for (const file of [...list].toSorted(byName)) {
    const isText = MEDIA.test(file.type) || TEXT.test(file.name);
    if (isPicture(file)) found.pictures.push(file);
    else if (isText && !/\.geojson$/i.test(file.name)) found.landmarks.push(file);
    else found.others.push(file);
  }
  return found;
}

/**
 * What is used of some files, in the order of their names: { project, picture, handles,
 * annotations, unused }. A project is used alone. Two landmark files are rest and pose; a file with
 * both sides is used alone. `most`: bytes of the largest text, a project; what is larger is refused
 * by its size, without being read. Throws a Problem.
 * @param {Iterable<File>} list
 * @param {number} most
 */
export async function sorted(list, most) {
  // A picture is read later: the page shows at once that it is being opened.
  /** @type {(file: File) => File | Promise<File>} */
  const read = (file) => (isPicture(file) || file.size > most ? file : inMemory(file));
  const files = await Promise.all([...list].toSorted(byName).map(read));
  const kinds = await Promise.all(files.map((file) => kindOf(file, most)));
  /** @type {(kind: FileKind) => File[]} */
  const of = (kind) => files.filter((_, k) => kinds[k] === kind);
  const [project, picture, annotations] = /** @type {const} */ ([
    "project",
    "picture",
    "annotations",
  ]).map((kind) => of(kind).at(0));
  const complete = of("handles");
  const handles = complete.length ? complete.slice(0, 1) : of("landmarks").slice(0, 2);
  /** @type {{ project?: File, picture?: File, handles: File[], annotations?: File }} */
  const chosen = project ? { project, handles: [] } : { picture, handles, annotations };
  const used = new Set([...Object.values(chosen).flat()]);
  return { ...chosen, unused: files.filter((file) => !used.has(file)).map(({ name }) => name) };
}
